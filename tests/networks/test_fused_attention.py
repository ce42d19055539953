"""Attention as the exported graph has it answers as torch's does, whatever the mask."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxscript")

import onnxruntime
import torch
from torch import nn

from motionmend.networks.export import _quiet
from motionmend.networks.fused_attention import TRANSLATIONS


class Meet(nn.Module):
    def forward(self, query, key, value, mask=None):
        return nn.functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)


def masks(kind: str):
    there = torch.ones(3, 1, 1, 7, dtype=torch.bool)
    if kind == "padded":
        there[0, ..., 4:], there[1] = False, False  # the second window has nothing
    full = torch.randn(3, 2, 5, 7)
    return {"none": None, "whole": there, "padded": there, "added": full, "full": full > -1}[kind]


@pytest.mark.parametrize("kind", ["none", "whole", "padded", "added", "full"])
def test_the_graph_attends_as_torch_does(kind):
    torch.manual_seed(0)
    inputs = {"query": torch.randn(3, 2, 5, 8), "key": torch.randn(3, 2, 7, 8), "value": torch.randn(3, 2, 7, 8)}
    if (mask := masks(kind)) is not None:
        inputs["mask"] = mask
    with _quiet():
        program = torch.onnx.export(Meet().eval(), kwargs=inputs, dynamo=True, verbose=False, input_names=list(inputs),
                                    custom_translation_table=TRANSLATIONS)  # fmt: skip
    assert program is not None
    fused = [node.op_type for node in program.model_proto.graph.node].count("MultiHeadAttention")
    assert fused == (kind not in ("added", "full"))
    session = onnxruntime.InferenceSession(program.model_proto.SerializeToString())
    answer = np.asarray(session.run(None, {name: each.numpy() for name, each in inputs.items()})[0])
    np.testing.assert_allclose(answer, Meet()(**inputs).numpy(), atol=1e-5)
