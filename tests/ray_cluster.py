"""A Ray cluster of several nodes on this machine, each with processes of its own, for the time of a test."""

import os
import random
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

OBJECT_STORE = 80_000_000
"""Bytes of each node: the least that Ray takes."""
SETTINGS = {
    # A node that is killed is missed after a second, not after a quarter of a minute.
    "health_check_initial_delay_ms": 0,
    "health_check_period_ms": 250,
    "health_check_timeout_ms": 2000,
    "health_check_failure_threshold": 3,
    "worker_niceness": 0,  # Ray's 15 would let its processes wait for all others of a busy machine
}
ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}


@contextmanager
def ray_cluster(nodes: int, cores_of_head: int = 0, **of_node: Any) -> Iterator[Any]:
    """A cluster of a head and so many nodes of one core; :class:`ray.cluster_utils.Cluster`, ended with the block.

    :param of_node: more arguments of its ``add_node`` for the nodes
    """
    folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp")  # short: the names of its sockets have at most 107 characters
    before = dict(os.environ)
    path = os.pathsep.join(filter(None, (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))))
    os.environ.update({**ENVIRONMENT, "RAY_TMPDIR": folder, "PYTHONPATH": path})
    try:
        from ray.cluster_utils import Cluster

        cluster = Cluster(
            initialize_head=True,
            head_node_args={
                "num_cpus": cores_of_head,
                "object_store_memory": OBJECT_STORE,
                "include_dashboard": False,
                "_system_config": SETTINGS,
            },
            shutdown_at_exit=True,
        )
        try:
            for _ in range(nodes):
                add_node(cluster, **of_node)
            yield cluster
        finally:
            for node in cluster.list_all_nodes()[::-1]:
                kill_node(cluster, node)
    finally:
        os.environ.clear()
        os.environ.update(before)
        shutil.rmtree(folder, ignore_errors=True)


def add_node(cluster: Any, **of_node: Any) -> Any:
    """Another node of one core."""
    return cluster.add_node(num_cpus=1, object_store_memory=OBJECT_STORE, **of_node)


def kill_node(cluster: Any, node: Any) -> None:
    """As a machine that loses its power: all its processes at once, Ray's agents among them, which may linger."""
    family = list[psutil.Process]()
    for service in node.all_processes.values():
        for info in service:
            with suppress(psutil.NoSuchProcess):
                family += psutil.Process(info.process.pid).children(recursive=True)
    cluster.remove_node(node, allow_graceful=False)
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.kill()


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
