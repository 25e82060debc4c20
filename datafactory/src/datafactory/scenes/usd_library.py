"""USD's library, imported in one place, because an interrupt must not meet it there.

USD loads parts of itself from C++ while they are imported. An exception that is raised meanwhile, Ctrl-C's too, is
printed as a warning with a traceback, and lost: the command would go on.
"""

from __future__ import annotations

from shared.processes.interrupt import uninterrupted

with uninterrupted():
    from pxr import Gf, Pcp, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel

__all__ = ["Gf", "Pcp", "Sdf", "Tf", "Usd", "UsdGeom", "UsdShade", "UsdSkel"]
