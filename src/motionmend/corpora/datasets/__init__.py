"""Data sets: one module each, that knows its layout and nothing of corpora.

A module has NAME, LICENCE, CREDIT and `read(source, *, stage)`, which yields a `Raw` for every take in a fixed order,
and a `Dropped` for every file that could not be one. `takes` is what the readers of loose files share.
"""

from __future__ import annotations

DATASETS = {
    "cmu": ".cmu:read",
    "reactidle": ".reactidle:read",
    "bandai": ".bandai:read",
    "free": ".free:read",
    "folder": ".folder:read",
    "h36m": ".h36m:read",
    "holden": ".holden:read",
    "amass": ".amass:read",
    "lafan1": ".lafan1:read",
}
