"""How a network is trained: one dataclass that is the command's options, the saved file and the checkpoint's record."""

from __future__ import annotations

import math
import tomllib
import typing
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from ..errors import InputError, nearest_names


@dataclass(frozen=True, kw_only=True)
class Settings:
    name: str
    """The network: a registered name, or package.module:Class for one of your own."""
    corpus: tuple[str, ...] = ()
    """Corpora to train on; samples are drawn from each in proportion to its hours."""
    start: str = ""
    """Name or path of a checkpoint whose weights training begins with; chance if empty."""
    steps: int = 10_000
    """Training steps in all."""
    batch: int = 128
    """Windows a step, over all processes."""
    optimiser: Literal["adamw", "muon"] = "adamw"
    """muon turns the steps of the matrices in a network's `blocks` so that no direction is learned sooner than others,
    and leaves the rest to AdamW."""
    lr: float = 3e-4
    """Peak learning rate."""
    betas: tuple[float, float] = (0.9, 0.999)
    """Adam's decay rates."""
    weight_decay: float = 0.0
    """Decoupled weight decay (AdamW)."""
    warmup: float = 0.02
    """Share of the steps in which the learning rate climbs linearly to its peak; from 1 on, the steps themselves."""
    schedule: Literal["cosine", "constant", "step", "trapezoid"] = "cosine"
    """After the warm-up: down to zero along half a cosine, constant, a quarter every --step-every steps, or constant
    and straight to zero in the last fifth, so that a run can be made longer until then."""
    step_every: int = 80_000
    """Steps between the falls of the schedule `step`."""
    clip: float = 1.0
    """Largest norm of the gradient; 0 for no limit."""
    ema: float = 0.999
    """Decay of the moving average of weights, which is what is validated and exported; 0 for none."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the network; auto is bf16 autocast where the machine is faster at it, otherwise fp32."""
    compile: bool = False
    """Compile the network with torch.compile."""
    seed: int = 0
    """Seed of weights, samples and dropout."""
    stride: int = 1
    """Frames between the first frames of training windows."""
    anywhere: bool = False
    """Training windows begin anywhere, between frames too, at 0.8 to 1.25 of their pace in a third of all draws, and
    reach beyond takes now and then; no take counts for more than a minute of it."""
    workers: int = 0
    """Processes that make the samples, where one thread beside the network is too slow (see the waiting it tells)."""
    validate_every: int = 1000
    """Steps between validations; 0 for only one, at the end."""
    validation_windows: int = 256
    """Windows of the validation split that each validation looks at."""
    checkpoint_every: int = 1000
    """Steps between checkpoints; 0 to go by time only."""
    checkpoint_minutes: float = 10.0
    """Minutes between checkpoints, besides those by steps; 0 to go by steps only."""
    keep: int = 0
    """How many earlier checkpoints by steps stay beside the last one."""
    log_every: int = 50
    """Steps between lines of log.jsonl."""
    network: Any = None
    """Sizes and options of the network itself."""


# What a resumed run may change, because no weight depends on it.
FREE = {
    "workers", "validate_every", "validation_windows", "checkpoint_every", "checkpoint_minutes", "keep", "log_every",
}  # fmt: skip
# What it may change as long as the learning rates of the steps already taken stay the same.
FALL = 0.2  # share of the steps in which the schedule `trapezoid` goes down
RATES = {"steps", "lr", "warmup", "schedule", "step_every"}


def rate(settings: Settings, step: int) -> float:
    """The learning rate of a step, counted from 0."""
    climb = round(settings.warmup if settings.warmup >= 1 else settings.warmup * settings.steps)
    if step < climb:
        return settings.lr * (step + 1) / climb
    if settings.schedule == "cosine":
        return settings.lr * 0.5 * (1 + math.cos(math.pi * (step - climb) / max(1, settings.steps - climb)))
    if settings.schedule == "step":
        return settings.lr * 0.25 ** (step // settings.step_every)
    if settings.schedule == "trapezoid":
        return settings.lr * min(1.0, (settings.steps - step) / (FALL * settings.steps))
    return settings.lr


def settle(name: str, network: type, *layers: Mapping[str, Any]) -> Settings:
    """Settings for a network class: Settings' defaults, then the network's own, then each layer over those before."""
    values: dict[str, Any] = {"name": name}
    sizes: dict[str, Any] = {}
    for layer in (getattr(network, "DEFAULTS", {}), *layers):
        values |= {key: value for key, value in layer.items() if key != "network"}
        sizes |= layer.get("network", {})
    config = network.Config  # type: ignore[attr-defined]
    for field in getattr(network, "LASTING", ()):
        if field not in sizes and getattr(config(), field):
            sizes[field] = values.get("steps", Settings.steps)
    return typed(Settings, values | {"network": typed(config, sizes, f"[network] of {name}")}, "settings")


def read(path: Path, name: str) -> dict[str, Any]:
    """The layer that a TOML file holds. InputError as for `parse`, and where there is no such file."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"this is not TOML: {error}", where=path) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=path) from None
    return parse(text, name, path)


def parse(text: str, name: str, path: Path) -> dict[str, Any]:
    """The layer that TOML from `path` holds. InputError where it is not TOML or is for another network than `name`."""
    try:
        layer = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"this is not TOML: {error}", where=path) from None
    check_keys(Settings, layer, path)
    if layer.get("name", name) != name:
        raise InputError(f"these settings are for {layer['name']!r}, not {name!r}", where=path)
    if not isinstance(layer.get("network", {}), dict):
        raise InputError("network is not a table", where=path, expected="[network] and its options below it")
    return layer


def write(settings: Settings) -> str:
    """The settings as TOML that `read` and `parse` read back."""
    import tomli_w

    return tomli_w.dumps(asdict(settings))


def changes(old: Settings, new: Settings, done: int) -> list[str]:
    """What of `new` would give other weights than `old` had after `done` steps, in words; empty if nothing."""
    same_rates = all(rate(old, step) == rate(new, step) for step in range(done)) and new.steps >= done
    free = FREE | {"corpus"} | (RATES if same_rates else set())
    flat_old, flat_new = flatten(asdict(old)), flatten(asdict(new))
    return [
        f"{key} is {flat_new.get(key)!r} and was {flat_old.get(key)!r}"
        for key in flat_old | flat_new
        if key not in free and flat_old.get(key) != flat_new.get(key)
    ]


def flatten(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as one, with dotted names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= flatten(value, f"{before}{key}.") if isinstance(value, dict) else {before + key: value}
    return flat


def check_keys(kind: type, values: Mapping[str, Any], where: object) -> None:
    known = [field.name for field in fields(kind)]
    for key in values:
        if key not in known:
            raise InputError(f"there is no option {key!r}", where=where, hint=nearest_names(key, known))


def typed(kind: type, values: Mapping[str, Any], where: object) -> Any:
    """An instance of the dataclass `kind`; InputError where a name is unknown or a value is not of its type."""
    check_keys(kind, values, where)
    hints = typing.get_type_hints(kind)
    absent = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    if missing := [name for name in absent if name not in values]:
        raise InputError(f"{missing[0]} is not given", where=where)
    return kind(**{key: _as(hints[key], value, key, where) for key, value in values.items()})


def _as(hint: Any, value: Any, key: str, where: object) -> Any:
    """A value from TOML or Python as its annotation wants it: lists as tuples, whole numbers as floats."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal and value not in inner:
        raise InputError(f"{key} is {value!r}", where=where, expected="one of " + ", ".join(map(str, inner)))
    if origin is tuple and isinstance(value, list | tuple):
        kinds = (inner[0],) * len(value) if inner[-1] is Ellipsis else inner
        if len(kinds) != len(value):
            raise InputError(f"{key} has {len(value)} values", where=where, expected=f"{len(kinds)}")
        return tuple(_as(kind, part, key, where) for kind, part in zip(kinds, value))
    if hint is float and type(value) is int:
        return float(value)
    if is_dataclass(hint) and isinstance(value, dict):
        return typed(hint, value, where)  # type: ignore[arg-type]
    plain = origin if origin is tuple else hint
    if plain in (bool, int, float, str, tuple) and type(value) is not plain:
        raise InputError(f"{key} is {value!r}", where=where, expected=f"a value of type {plain.__name__}")
    return value


def check(settings: Settings) -> None:
    """InputError where a number cannot be meant."""
    least = {"steps": 1, "batch": 1, "stride": 1, "step_every": 1, "log_every": 1, "validation_windows": 1, "seed": 0,
             "validate_every": 0, "checkpoint_every": 0, "checkpoint_minutes": 0, "keep": 0, "clip": 0, "workers": 0,
             "weight_decay": 0, "warmup": 0}  # fmt: skip
    for key, low in least.items():
        if not getattr(settings, key) >= low:
            raise InputError(f"{key} is {getattr(settings, key):g}", expected=f"at least {low}")
    if not 0 <= settings.ema < 1:
        raise InputError(f"ema is {settings.ema:g}", expected="from 0 to below 1")
    if not 0 < settings.lr < math.inf:
        raise InputError(f"lr is {settings.lr:g}", expected="above 0")
    if not all(0 <= beta < 1 for beta in settings.betas):
        raise InputError("betas are {:g} and {:g}".format(*settings.betas), expected="from 0 to below 1")
    if not settings.corpus:
        raise InputError("no corpus was named", hint="say --corpus cmu.corpus; `motionmend data build` makes one")


def resolved(settings: Settings, precision: str) -> Settings:
    """The settings with `auto` replaced by what this machine does."""
    return replace(settings, precision=precision) if settings.precision == "auto" else settings
