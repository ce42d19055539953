"""The fill `average`: several simple models, each believed where the distances that it gives are likely.

Tits, Tilmanne & Dutoit 2018, "Robust and automatic motion-capture data recovery using soft skeleton constraints and
model averaging", PLoS ONE 13(7). The likelihood of a distance to a steady neighbour is a kernel density estimate of
those seen (Silverman's bandwidth), a model's weight in a frame the product over the neighbours, and the models meet
the gap's ends before they are averaged. The paper's models are a local frame, a polynomial, a GRNN, a linear
regression and principal components; these are a linear regression on a few donors and three of `regression`'s on ever
more, which were nearer to the truth together on training takes.
"""

from __future__ import annotations

import numpy as np

from .donors import Chart
from .lessons import Lesson
from .regression import DONORS, regressed

Array = np.ndarray

FEW, MANY = 5, 20  # donors of the smallest and the largest model
LINEAR, PENALTY = 6, 0.3  # donors of the linear one, and its penalty
NEIGHBOURS = 3
SEEN = 100  # distances, at most, that make up a density
SURE_SHARE = 1e-3  # of a distance: no density is narrower
TINY = 1e-12  # metres, for a donor at the marker's own place


def average_chart(one: Lesson) -> Chart | None:
    """Coordinates about the models' average."""
    models = [regressed(one.only(range(donors))) for donors in (FEW, DONORS, MANY)]
    models.append(regressed(one.only(range(LINEAR)), bell=0.0, penalty=PENALTY))
    paths = [model.path(one.start, one.stop, one.fps, "ramp") for model in models if model is not None]
    if not paths:
        return None
    answers = np.stack(paths)
    answer = np.einsum("mf,mfi->fi", likelihoods(one, answers), answers)
    return Chart(one.donors, one.near, np.zeros((len(one.near), 3)), lambda miss: answer + miss)


def likelihoods(one: Lesson, answers: Array) -> Array:
    """The weights `(models, gap frames)`, which sum to 1 over the models, of `answers (models, gap frames, 3)`."""
    inside, total = one.asked[len(one.near) :], np.zeros(answers.shape[:2])
    for donor in range(min(NEIGHBOURS, len(one.donors))):
        seen = np.linalg.norm(one.own - one.known[:, donor], axis=-1)
        width = 1.06 * seen.std() * len(seen) ** -0.2 + SURE_SHARE * one.apart[donor] + TINY
        seen = np.quantile(seen, (np.arange(SEEN) + 0.5) / SEEN) if len(seen) > SEEN else seen
        off = (np.linalg.norm(answers - inside[:, donor], axis=-1)[..., None] - seen) / width
        # The log of the mean of the bells, from the nearest on: far from all of them it still says which is nearer.
        nearest = np.min(off**2, axis=-1, keepdims=True)
        total += np.log(np.mean(np.exp(-0.5 * (off**2 - nearest)), axis=-1)) - 0.5 * nearest[..., 0]
    weights = np.exp(total - total.max(axis=0))
    return weights / weights.sum(axis=0)
