"""Frames on a Ray cluster.

Three places, three modules. :mod:`.engine` is in the process of the command: it hands out portions and takes rows back.
:mod:`.driver` is a process beside it, the only one here that holds a connection to Ray: what Ray prints, what it does
with signals, and how it ends where its cluster is gone, stay in there. :mod:`.node` is what the cluster's nodes do.
"""
