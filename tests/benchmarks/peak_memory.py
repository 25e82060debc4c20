"""Make one moving cube of the default radar in a process of its own; print its largest resident size [MB]."""

from __future__ import annotations

import resource
import sys

from workloads import EGO_SPEED_MPS, street

from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar

if __name__ == "__main__":
    cube_of_paths(street(int(sys.argv[1]), EGO_SPEED_MPS), Radar())
    # Linux reports kilobytes, macOS bytes.
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6)
