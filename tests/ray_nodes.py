"""The cluster of ``make soak``: nodes that are lost and replaced, and the processes that work on them."""

from __future__ import annotations

import random
from contextlib import suppress
from typing import Any

import psutil
from ray_cluster import add_node, kill_node

TASK = "ray::make_portion"
"""How a process of Ray's calls itself while it makes a shard."""


class Nodes:
    """Nodes of a :class:`ray.cluster_utils.Cluster` that may be lost.

    :param chance: which
    """

    def __init__(self, cluster: Any, chance: random.Random) -> None:
        self._cluster, self._chance = cluster, chance

    @property
    def address(self) -> str:
        """HOST:PORT."""
        return str(self._cluster.address)

    def lose_one(self) -> None:
        """Kill all processes of a node (SIGKILL), and bring another in its place."""
        kill_node(self._cluster, self._chance.choice(sorted(self._cluster.worker_nodes, key=lambda node: node.node_id)))
        add_node(self._cluster)

    def at_work(self) -> list[psutil.Process]:
        """Processes that make shards."""
        session, found = self._cluster.head_node.get_session_dir_path(), []
        for process in psutil.process_iter():
            with suppress(psutil.Error):
                raylet = process.parent()
                if raylet and TASK in " ".join(process.cmdline()) and session in " ".join(raylet.cmdline()):
                    found.append(process)
        return found
