"""The model card of a checkpoint, in the form that Hugging Face reads: YAML at the top, then Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from .checkpoints import span

# Keys of the budget that have a line of their own in the card; all others are listed as they are.
_TOLD = {"corpus": "Corpus", "licence": "Licence of the data", "credit": "Credit", "data sha256": "Data hash"}
_ELSEWHERE = {*_TOLD, "validated by", "beside"}


def write_card(facts: Mapping[str, Any], title: str) -> str:
    """The README.md of a checkpoint.

    Parameters
    ----------
    facts : what its `config.json` holds, save the hashes: network, space, fps, frames, skeleton, config, parameters,
        budget, validation, parity, …
    title : the name it goes by.
    """
    network, budget, validation = facts["network"], facts["budget"], facts["validation"]
    licence = str(budget.get("licence", "")) or "unknown"
    front = {
        "license": "other", "license_name": licence, "library_name": "motionmend",
        "pipeline_tag": "other", "tags": ["motion-capture", "human-motion", "onnx", network.split(":")[-1]],
    }  # fmt: skip
    if budget.get("corpus"):
        front["datasets"] = _as_list(budget["corpus"])
    # JSON is YAML: names with colons or quotes in them need no rules of our own.
    yaml = "\n".join(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in front.items())
    joints = len(facts["skeleton"]["names"])
    measured, beside = budget.get("validated by", ""), budget.get("beside", {})
    seconds = facts["frames"] / facts["fps"]
    does = (
        "makes motions that go on from a first pose along whatever paths it is given"
        if facts["generative"]
        else "fills what is missing in human motion capture"
        + ("" if only_fills(facts) else ", and can rewrite what is there")
    )
    lines = [
        f"---\n{yaml}\n---",
        f"# {title}",
        f"This network {does}: windows of {facts['frames']} frames at {facts['fps']:g} frames per second "
        f"({seconds:.3g} s) of {joints} joints, positions in metres with Y up. It is `{network}` of "
        f"motionmend, with {facts['parameters']:,} parameters.",
        "## Use",
        "```python\nimport motionmend as mm\n\n"
        f'completer = mm.load_completer("{title}")   # or the path of this folder; runs without torch\n'
        'take = mm.load("broken.bvh")\n'
        f"{_USE_SAMPLES if facts['generative'] else _USE_FILL}```",
        "The take may have any length, frame rate and rig in which motionmend finds a human body. Observed samples "
        "come back bit for bit.",
        "## Data",
        _bullets({label: budget.get(key) or "not told" for key, label in _TOLD.items()}),
        "Who uses these weights is bound by the licence of the data"
        + (", which forbids **commercial use**." if "-NC" in licence else "."),
        "## Training",
        _training({key: value for key, value in budget.items() if key not in _ELSEWHERE}) or "Not told.",
        "Sizes and options of the network:",
        _bullets(facts["config"]) or "none",
        "## Results",
        _results(validation, measured, beside) if validation else "It was not validated.",
        "The graph's answers to real windows differ from those of the network in training by at most "
        f"{1000 * facts['parity']:.2g} mm.",
        "## Files",
        "`model.onnx` to run (weights in half precision, arithmetic in single), `model.safetensors` to train on, "
        "`config.json` with the skeleton, the training and the SHA-256 of each file.",
    ]
    return "\n\n".join(lines) + "\n"


def only_fills(facts: Mapping[str, Any]) -> bool:
    """Whether a network leaves what it is shown as it is, wherever that is."""
    return facts["space"].startswith("poses_off_curves") or facts["config"].get("begin") == "curve"


_USE_FILL = "fixed = completer.complete(take.motion)   # what is unobserved is filled\n"
_USE_SAMPLES = "ways = completer.sample(take.motion, 5, seed=0)   # five ways to go on from the first frame\n"


def _as_list(value: Any) -> list[str]:
    return [str(each) for each in value] if isinstance(value, list | tuple) else [str(value)]


def _bullets(values: Mapping[str, Any]) -> str:
    return "\n".join(f"- {key}: {_words(value)}" for key, value in values.items())


def _training(values: dict[str, Any]) -> str:
    """What training took, in the order of the budget; a step chosen by validation says so."""
    steps, whole = values.get("steps"), values.pop("steps of the run", None)
    if whole is not None and whole != steps:
        values["steps"] = f"{_words(steps)}, the best by validation of a run of {_words(whole)}"
    if isinstance(values.get("seconds"), int | float):
        seconds = values["seconds"]
        values = {("time" if key == "seconds" else key): value for key, value in values.items()}
        values["time"] = f"{span(seconds)}, all of the run"
    return _bullets(values)


def _words(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_words, value))
    if isinstance(value, float):
        return f"{value:g}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


def _results(values: Mapping[str, Any], measured: str, beside: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of validation's numbers, below what they are; `beside` has those of others by their names."""
    columns = {"this network": values, **beside}
    rows = [[metric, *(_words(each.get(metric, "")) for each in columns.values())] for metric in values]
    lines = [["validation", *columns], ["---"] * (1 + len(columns)), *rows]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"By {measured}.\n\n{table}" if measured else table
