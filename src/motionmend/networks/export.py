"""Export: a torch network as a checkpoint folder that runs without torch.

Weights are rounded to half precision before anything else, so that the torch network, the graph and the stored weights
are the same numbers; the graph computes in single precision.
"""

from __future__ import annotations

import contextlib
import copy
import inspect
import json
import logging
import os
import shutil
import warnings
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from onnxscript.optimizer import optimize_ir

from .. import __version__
from ..errors import InputError
from ..io import sha256_of
from ..motion import Skeleton
from .card import write_card
from .checkpoints import CARD, CONFIG, GRAPH, VERSION, WEIGHTS, Description, name_of
from .fused_attention import TRANSLATIONS
from .loading import completer
from .models import NETWORKS
from .models.network import Network
from .runtimes import Graph, Module
from .spaces import SPACES

Array = np.ndarray

PARITY = 1e-4  # metres
SMALL = 64  # elements: initialisers below this are not worth a Cast


def export(
    network: Network,
    target: str | os.PathLike,
    *,
    skeleton: Skeleton,
    windows: tuple[Array, Array],
    budget: dict[str, Any] | None = None,
    validation: dict[str, float] | None = None,
    force: bool = False,
) -> Path:
    """Write a network as a checkpoint folder, whole or not at all; returns the folder.

    Parameters
    ----------
    network : is left as it is.
    skeleton : of the network's joints.
    windows : real ones, positions `(B, T, J, 3)` metres and observed `(B, T, J)`, two or more, on which the graph must
        answer as the network does.
    budget : what training took, as JSON: steps, batch, seconds, machine, threads, seed, commit, corpus, data sha256,
        licence, credit; all of it is told in the model card.
    validation : metric → value.
    force : replace a folder that exists.

    Raises
    ------
    InputError : if the folder exists, a weight is too large for half precision, or the graph's answer differs by more
        than PARITY from the network's.
    """
    target = Path(target)
    if target.exists() and not force:
        raise InputError("the folder exists", where=target, hint="choose another name, or overwrite it with --force")
    if not target.parent.is_dir():
        raise InputError("no such folder", where=target.parent)
    rounded = halved(network)
    description = Description.of(rounded, skeleton, address_of(network))
    aside = _beside(target, "part")
    aside.mkdir()
    try:
        inputs = example(rounded, windows)
        model = graph_of(rounded, inputs)
        (aside / GRAPH).write_bytes(model.SerializeToString(deterministic=True))
        difference = parity(rounded, description, aside / GRAPH, windows)
        if not difference <= PARITY:
            raise InputError(f"the graph's answer differs from the network's by {difference:.2g} m",
                             expected=f"at most {PARITY:g} m")  # fmt: skip
        _write_weights(rounded, aside / WEIGHTS)
        facts = {
            "version": VERSION, "network": description.network, "space": description.space, "fps": description.fps,
            "frames": description.frames, "any_length": description.any_length, "longest": description.longest,
            "generative": description.generative, "noise_size": description.noise_size,
            "skeleton": {"names": list(skeleton.names), "parents": list(skeleton.parents)},
            "config": asdict(network.config), "parameters": sum(each.numel() for each in network.parameters()),
            "inputs": {each.name: [axis.dim_param or axis.dim_value for axis in each.type.tensor_type.shape.dim]
                       for each in model.graph.input},
            "budget": budget or {}, "validation": validation or {}, "parity": difference, "motionmend": __version__,
        }  # fmt: skip
        (aside / CARD).write_text(write_card(facts, name_of(target)), encoding="utf-8")
        facts["sha256"] = {name: sha256_of(aside / name) for name in (GRAPH, WEIGHTS, CARD)}
        (aside / CONFIG).write_text(json.dumps(facts, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        _put(aside, target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return target


def address_of(network: Network) -> str:
    """The name by which `models.network_class` finds this network's class."""
    kind = type(network)
    address = f"{kind.__module__}:{kind.__qualname__}"
    registered = NETWORKS.get(kind.name, "").replace(".", "motionmend.networks.models.", 1)
    return kind.name if registered == address else address


def halved(network: Network) -> Network:
    """A copy on the CPU, in evaluation mode, whose stored weights are rounded to half precision."""
    network = copy.deepcopy(network).cpu().eval()
    for name, value in network.state_dict().items():
        if value.is_floating_point():
            half = value.half()
            if not torch.isfinite(half).all():
                raise InputError(f"{name} holds numbers that half precision does not", hint="did training diverge?")
            value.copy_(half)  # a state_dict's tensors are the network's own
    return network


def example(network: Network, windows: tuple[Array, Array]) -> dict[str, torch.Tensor]:
    """The graph's inputs for the first windows. Two or more: the exporter takes a batch of one for a constant."""
    positions, observed = (np.concatenate([each, each])[:2] if len(each) < 2 else each[:2] for each in windows)
    inputs, _ = SPACES[network.space]().encode(positions, observed)
    if network.generative:
        inputs = {**inputs, "noise": np.zeros((2, network.noise_size), np.float32)}
    order = inspect.signature(network.forward).parameters
    return {name: torch.from_numpy(np.ascontiguousarray(inputs[name])) for name in order if name in inputs}


def graph_of(network: Network, inputs: dict[str, torch.Tensor]):
    """The network as an ONNX model, its free axes free, its weights in half precision, its attention fused."""
    free = {name: torch.export.Dim(name) for of_input in network.axes.values() for name in of_input.values()}
    axes: dict[str, dict[int, Any]] = {
        name: {0: torch.export.Dim("batch")} | {axis: free[each] for axis, each in network.axes.get(name, {}).items()}
        for name in inputs
    }
    if network.any_length:
        frames = torch.export.Dim("frames")
        for name in ("positions", "observed"):
            if name in axes:
                axes[name][1] = frames
    with _quiet():
        program = torch.onnx.export(
            network, args=(), kwargs=inputs, input_names=list(inputs), output_names=["output"],
            dynamic_shapes=axes, dynamo=True, verbose=False, custom_translation_table=TRANSLATIONS,
            optimize=False,
        )  # fmt: skip
    assert program is not None
    # Sums of weights stay sums: half precision does not hold them, and they are larger.
    optimize_ir(program.model, output_size_limit=SMALL)
    model = program.model_proto
    _forget_origin(model)
    _store_halves(model.graph)
    return model


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's remarks on its own code, on axes that share a name, and on absent torchvision."""
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=r"`isinstance\(treespec, LeafSpec\)`", category=FutureWarning)
            warnings.filterwarnings("ignore", message=r"# The axis name: .* will not be used", category=UserWarning)
            yield
    finally:
        logger.setLevel(level)


def _forget_origin(model) -> None:
    """Take out doc strings and metadata: the exporter keeps stack traces with this machine's paths in them."""
    model.ClearField("doc_string")
    model.ClearField("metadata_props")
    parts, graphs = [], [model.graph]
    for graph in graphs:  # it grows: the bodies of loops are graphs too
        parts += [graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer]
        graphs += [each.g for node in graph.node for each in node.attribute if each.HasField("g")]
    for function in model.functions:
        parts += [function, *function.node, *function.value_info]
    for part in parts:
        part.ClearField("doc_string")
        part.ClearField("metadata_props")


def _store_halves(graph) -> None:
    """Store large float32 initialisers as float16 where that holds them exactly, and cast them back in the graph."""
    from onnx import TensorProto, helper, numpy_helper

    casts = []
    for tensor in graph.initializer:
        if tensor.data_type != TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(tensor)
        with np.errstate(over="ignore"):
            half = values.astype(np.float16)
        if values.size < SMALL or not np.array_equal(half, values):
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(half, f"{name}.half"))
        casts.append(helper.make_node("Cast", [f"{name}.half"], [name], name=f"{name}.cast", to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def parity(network: Network, description: Description, graph: Path, windows: tuple[Array, Array]) -> float:
    """The largest difference in metres between the answers of the network and of its graph to these windows."""
    torch_answer, graph_answer = (
        completer(description, run).windows(*windows) for run in (Module(network), Graph(graph))
    )
    difference = np.abs(torch_answer - graph_answer)
    return float(difference.max()) if np.isfinite(difference).all() else float("inf")


def _write_weights(network: Network, path: Path) -> None:
    from safetensors.torch import save_file

    state = network.state_dict()
    halves = {name: value.half() if value.is_floating_point() else value for name, value in state.items()}
    # Clones, because tied weights share memory, which safetensors refuses.
    save_file({name: value.contiguous().clone() for name, value in halves.items()}, path)


def _put(aside: Path, target: Path) -> None:
    """Rename a finished folder into its place; what was there goes only when the new one stands."""
    old = _beside(target, "old")
    if target.exists():
        target.rename(old)
    aside.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def _beside(target: Path, kind: str) -> Path:
    """A name for a hidden folder beside the target, that no other process takes."""
    return target.with_name(f".{target.name}.{os.getpid()}.{kind}")
