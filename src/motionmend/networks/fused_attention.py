"""Attention in exported graphs as one node, which onnxruntime computes without ever holding all the scores.

Its MultiHeadAttention does so (Dao 2022's FlashAttention) as long as it is given no mask. Tokens that are not there are
therefore hidden by one more dimension of queries and keys, in which a query is 1 and such a key is HIDDEN. Where all
tokens are there, that dimension has the length 0.

B = windows, H = heads, Q = queries, N = keys.
"""

from __future__ import annotations

from typing import Any

import onnx
import torch
from onnxscript import opset18
from onnxscript.values import Op, Opset

HIDDEN = -1e9  # beside any other score, exp of it is 0

op: Any = opset18  # symbols go in and out, and its types speak of arrays
_of: Any = onnx.defs.OpSchema
_SCHEMA = _of(
    "MultiHeadAttention", "com.microsoft", 1,
    inputs=[_of.FormalParameter(name, "T") for name in ("query", "key", "value")],
    outputs=[_of.FormalParameter("output", "T")],
    type_constraints=[("T", ["tensor(float)"], "")],
    attributes=[_of.Attribute("num_heads", _of.AttrType.INT), _of.Attribute("scale", _of.AttrType.FLOAT)],
)  # fmt: skip
_fused = Op(Opset("com.microsoft", 1), "MultiHeadAttention", _SCHEMA)


def attention(
    query: Any, key: Any, value: Any, attn_mask: Any = None, dropout_p: float = 0.0, is_causal: bool = False,
    scale: float | None = None, enable_gqa: bool = False,
) -> Any:  # fmt: skip
    """ONNX nodes for torch's `scaled_dot_product_attention` of `(B, H, Q, width)` to `(B, H, N, width)`.

    With a mask bool `(B, 1, 1, N)`, or none, one fused node; with any other, the products one by one. A window in
    which no token is there gets zeros, as in torch.
    """
    del dropout_p
    if is_causal or enable_gqa:
        raise NotImplementedError("causal and grouped attention have no use here yet")
    heads, width = query.shape[-3], query.shape[-1]
    scale = float(width**-0.5 if scale is None else scale)
    masked = attn_mask is not None
    by_key = not masked or (_is_bool(attn_mask) and tuple(attn_mask.shape[1:3]) == (1, 1))
    if not by_key or len(query.shape) != 4:
        return _step_by_step(query, key, value, attn_mask, scale)
    query, key, value = (op.Transpose(each, perm=[0, 2, 1, 3]) for each in (query, key, value))
    if masked:
        there = op.Transpose(op.Cast(attn_mask, to=onnx.TensorProto.FLOAT), perm=[0, 3, 1, 2])  # (B, N, 1, 1)
        away = op.Sub(_floats(1), there)
        more = op.Reshape(op.Cast(op.ReduceMax(away, keepdims=0), to=onnx.TensorProto.INT64), _ints(1))
        query, key = _longer(query, _floats(1), more), _longer(key, op.Mul(away, _floats(HIDDEN)), more)
        value = op.Mul(value, there)
    query, key, value = (op.Reshape(each, _ints(0, 0, -1)) for each in (query, key, value))
    met = _fused(query, key, value, num_heads=int(heads), scale=scale)
    return op.Transpose(op.Reshape(met, _ints(0, 0, heads, -1)), perm=[0, 2, 1, 3])


TRANSLATIONS = {torch.ops.aten.scaled_dot_product_attention.default: attention}


def _longer(x: Any, what: Any, more: Any) -> Any:
    """`(B, N, H, width)` with `more` of `what` at the end of the last axis, `more (1,)` being 0 or 1."""
    shape = op.Concat(op.Shape(x, end=3), more, axis=0)
    return op.Concat(x, op.Expand(op.Slice(what, _ints(0), more, _ints(-1)), shape), axis=-1)


def _step_by_step(query: Any, key: Any, value: Any, mask: Any, scale: float) -> Any:
    axes = len(key.shape)
    scores = op.MatMul(op.Mul(query, _floats(scale)), op.Transpose(key, perm=[*range(axes - 2), axes - 1, axes - 2]))
    if mask is not None:
        scores = op.Add(scores, op.Where(mask, _floats(0), _floats(HIDDEN)) if _is_bool(mask) else mask)
    return op.MatMul(op.Softmax(scores, axis=-1), value)


def _is_bool(mask: Any) -> bool:
    return mask.dtype == onnx.TensorProto.BOOL


def _ints(*values: int) -> Any:
    return op.Constant(value_ints=[int(each) for each in values])


def _floats(value: float) -> Any:
    return op.Constant(value_floats=[float(value)])
