"""How the three papers trained, as layers of settings: `train NAME --paper DATA`.

Björkstrand et al. 2023 (XMAE), section 4.1; Kaufmann et al. 2020 (ConvAE), sections 3.3 and 4, steps from the names of
the authors' checkpoints; Kania et al. 2021 (TrajeVAE), section 4.2 and appendix B. ConvAE was trained on Holden's data
only, TrajeVAE on two sets alike: those have one line for all. CMU is what most of Holden's data is made of.
"""

from __future__ import annotations

from typing import Any, Literal

from ..errors import InputError

Data = Literal["holden", "h36m", "amass", "cmu"]

_PLAIN = {"optimiser": "adamw", "weight_decay": 0.0, "clip": 0.0, "ema": 0.0, "anywhere": False}
_XMAE = _PLAIN | {
    "batch": 128, "lr": 3e-4, "betas": (0.9, 0.999), "schedule": "cosine",
    "network": {"codes": "shared", "structured": False},
}  # fmt: skip
_XMAE_STEPS = {"holden": (100_000, 2_200), "h36m": (60_000, 1_200), "amass": (240_000, 5_000)}  # of them warm-up
_CONVAE = _PLAIN | {
    "batch": 80, "lr": 1e-3, "betas": (0.9, 0.999), "schedule": "constant", "warmup": 0.0, "stride": 120,
}  # fmt: skip
_CONVAE_STEPS = {"curriculum": 58_704, "fixed": 29_204, "vanilla": 18_521}  # 200, 100 and 63 epochs
_HOLDEN = _CONVAE | {"lr": 1e-5, "steps": 20_285}  # 70 epochs
_TRAJEVAE = _PLAIN | {
    "batch": 64, "lr": 1e-4, "betas": (0.9, 0.99), "schedule": "step", "step_every": 80_000, "warmup": 0.0,
    "steps": 240_000,
}  # fmt: skip


def layer(name: str, data: Data, config: Any) -> dict[str, Any]:
    """The settings with which a network's paper trained it on this data, for `config.settle`.

    config : of the network as it is asked for: ConvAE's variants took different numbers of steps.

    Raises
    ------
    InputError : for a network that is none of the papers'.
    """
    if name == "xmae":
        steps, climb = _XMAE_STEPS["holden" if data == "cmu" else data]
        return _XMAE | {"steps": steps, "warmup": climb / steps}
    if name == "convae":
        kind = config.kind if config.kind == "vanilla" else "curriculum" if config.curriculum else "fixed"
        # The Vanilla AE is compared as Holden's is, with gaps of one length.
        gaps = {"network": {"curriculum": 0}} if kind == "vanilla" else {}
        return _CONVAE | {"steps": _CONVAE_STEPS[kind]} | gaps
    if name == "trajevae":
        return _TRAJEVAE | {"network": {"xavier": True}}
    plain = {"holden": _HOLDEN, "infilling": _TRAJEVAE, "cvae-rnn": _TRAJEVAE}
    if name not in plain:
        known = ", ".join(("xmae", "convae", "trajevae", *plain))
        raise InputError(f"no paper says how to train {name}", where="--paper", expected=f"one of {known}")
    return plain[name]
