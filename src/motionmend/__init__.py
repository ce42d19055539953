"""Repair human motion capture: find the damage, fill it, and give the same file back.

>>> import motionmend as mm
>>> take = mm.load("walk.bvh")
>>> fixed = mm.repair(take, gaps=[(120, 180)], method="hermite")
>>> mm.save(fixed, "fixed.bvh")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .animation.animating import animate as animate
    from .composition.blending import blend as blend
    from .composition.chaining import chain as chain
    from .damage.planting import plant as plant
    from .diagnosis.diagnosing import diagnose as diagnose
    from .errors import InputError as InputError
    from .io import load as load
    from .io import save as save
    from .memory.storing import Memory as Memory
    from .motion import Motion as Motion
    from .motion import Rig as Rig
    from .motion import Skeleton as Skeleton
    from .motion import Take as Take
    from .networks.loading import load_completer as load_completer
    from .repairs.comparison import compare as compare
    from .repairs.learning import learn as learn
    from .repairs.repairing import repair as repair
    from .rigs.fitting import fit as fit

# Loaded when first asked for, so that `import motionmend` costs nothing.
_HOME = {
    "InputError": "errors",
    "load": "io",
    "load_completer": "networks.loading",
    "save": "io",
    "Memory": "memory.storing",
    "Motion": "motion",
    "Rig": "motion",
    "Skeleton": "motion",
    "Take": "motion",
    "animate": "animation.animating",
    "blend": "composition.blending",
    "chain": "composition.chaining",
    "compare": "repairs.comparison",
    "diagnose": "diagnosis.diagnosing",
    "fit": "rigs.fitting",
    "learn": "repairs.learning",
    "plant": "damage.planting",
    "repair": "repairs.repairing",
}
__all__ = ["__version__", *_HOME]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # A function may share its module's name (motionmend.repair): the import binds the module here, so the
    # wanted object is bound over it.
    value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
