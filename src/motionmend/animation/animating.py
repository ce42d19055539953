"""The other main job: one pose and the paths of some joints in, any number of animations of the same rig out."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping as MappingABC
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..body.joints import BODY
from ..body.mapping import Mapping, map_rig, read_map, to_body
from ..constraints.ground import above_ground, grounded
from ..constraints.paths import FADE, TOLERANCE, carried, leads, meet
from ..constraints.seams import meet_seams
from ..errors import InputError
from ..fills.curves import least_jerk
from ..motion import Motion, Take, Units
from ..networks import checkpoints, windows
from ..networks.generative import GenerativeCompleter
from ..networks.loading import load_completer
from ..progress import Stage, silent
from ..rigs.puppet import Puppet, standing_rig
from .report import AnimationReport, Controlled, Seam, Variant, off_ground, stretch
from .subject import puppet
from .trajectories import Trajectory, from_take, gathered, sampled

Array = np.ndarray

NETWORK = "trajevae"
SECONDS = 2.0  # of an animation for which nothing says how long it is to be
JOIN, PACE = 0.5, 1.0  # seconds and metres a second in which a pose is led onto a path that begins elsewhere
MOST = 1_000_000  # frames


def animate(
    take: Take,
    trajectories: MappingABC[str, Any] | Sequence[tuple[str, Any]] = (),
    *,
    like: Take | None = None,
    joints: Sequence[str] = (),
    frame: int = 0,
    seconds: float | None = None,
    frames: int | None = None,
    samples: int = 1,
    mean: bool = False,
    diversity: float = 1.0,
    seed: int = 0,
    network: str | os.PathLike | GenerativeCompleter = NETWORK,
    raw_paths: bool = False,
    raw_bones: bool = False,
    raw_floor: bool = False,
    map: str | Path | dict[str, str] | None = None,
    stage: Stage = silent,
) -> list[Take]:
    """Animate the person of one pose along the paths of some joints, or of none.

    Parameters
    ----------
    take : its pose in `frame` is where the animation begins, and its rig, rate and format those of what comes out.
    trajectories : joint → a CSV file (`trajectories.read`), points `(keys, 3)` in metres with Y up, one a frame, or
        `(times (keys,) in seconds, points)`; as a mapping or as pairs.
    like, joints : another take, and its joints whose paths are carried over (`trajectories.from_take`).
    seconds, frames : how long; as long as the longest path, or 2 s.
    samples : how many variants. mean : instead, the network's one best guess. diversity : 0 to 1, scales its noise.
    seed : of the noise; variant k of a seed is the same bits however many are asked for.
    network : a generative network's name or folder, or the network itself.
    raw_paths : leave given joints where the network puts them. raw_bones : leave bones as long as it makes them; the
        result then has BODY's 21 joints as points. raw_floor : let the body float or sink as it does there.
    map : overrides of the rig's mapping, as for `repair`.
    stage : called with what is done next, for progress.

    Returns
    -------
    Takes whose first frame is the pose, number for number. The `report` of each is its own AnimationReport.

    Raises
    ------
    InputError : for paths, names and lengths that cannot be, where no person is found or no network is installed.
    """
    completer = generative(network)
    overrides = map if isinstance(map, dict) or map is None else read_map(map)
    mapping = _person(take, frame, overrides)
    paths = gathered(trajectories, take.skeleton, mapping, take.units, take.fps)
    if bool(joints) != (like is not None):
        found = "no joints are named" if like else "joints are named of no other take"
        raise InputError(found, expected="another take, and the names of joints in it")
    if like is not None:
        paths += from_take(like, joints, to_body(take.motion, mapping), frame)
    count = _length(paths, seconds, frames, take.fps)
    if samples < 1 or not 0 <= diversity <= 1 or seed < 0:
        found = f"{samples} samples, diversity {diversity:g}, seed {seed}"
        raise InputError(found, expected="1 sample or more, a diversity from 0 to 1, a seed from 0 on")
    if mean and samples > 1:
        raise InputError("the best guess is one", hint="ask for samples or for the mean")

    held = puppet(take, frame, count, mapping)
    for path in paths:
        if mapping.joints[path.joint] < 0:
            raise InputError(f"the rig has no joint for {path.name}", where=take.source)
    paths = [replace(path, name=take.skeleton.names[mapping.joints[path.joint]]) for path in paths]
    asked = Asked.of(held, paths, count, take.fps)
    spread = 0.0 if mean else diversity
    made = []
    for number in range(1, samples + 1):
        stage(f"variant {number} of {samples}" if samples > 1 else "animating")
        again = None if raw_bones else puppet(take, frame, 2, mapping)
        own = asked.answered(completer, (seed, number), spread, again, raw_paths)
        result = asked.mended(own, raw_paths, raw_bones, raw_floor)
        variant = asked.measured(number, own, result, completer, raw_bones)
        report = AnimationReport(
            source=Path(take.source).name, format=take.format, frame=frame, frames=count, fps=take.fps,
            units=take.units.why, network=completer.name, seed=seed, diversity=spread, variants=(variant,),
            notes=_notes(held, take),
        )  # fmt: skip
        made.append(replace(result if raw_bones else held.back(result), report=report))
    return made


def generative(network: str | os.PathLike | GenerativeCompleter) -> GenerativeCompleter:
    """The generative network of this name, or in this folder.

    Raises
    ------
    InputError : if there is none, and for one that only fills or that knows other joints than BODY's.
    """
    if isinstance(network, GenerativeCompleter):
        return network
    if str(network) == NETWORK and NETWORK not in checkpoints.names() and not Path(network).is_dir():
        hint = (f"train one (`motionmend train {NETWORK} --corpus … -o runs/{NETWORK}`), put its checkpoint folder "
                f"where ${checkpoints.PATH_VARIABLE} says, or name another with --network")  # fmt: skip
        raise InputError(f"no network named {NETWORK!r} is installed", hint=hint)
    loaded = load_completer(network)
    if not isinstance(loaded, GenerativeCompleter):
        found = f"{loaded.name} fills what is missing; it does not go on from a pose"
        raise InputError(found, expected=f"a generative network, such as {NETWORK}")
    if loaded.skeleton.names != BODY.names:
        raise InputError(f"{loaded.name} knows other joints than the {len(BODY)} of a body")
    return loaded


def _person(take: Take, frame: int, overrides: dict[str, str] | None) -> Mapping:
    """Which joint of the take is which, if the frame holds a person."""
    if not 0 <= frame < len(take):
        raise InputError(f"there is no frame {frame}", where=take.source, expected=f"one from 0 to {len(take) - 1}")
    seen = np.where(take.motion.observed[..., None], take.motion.positions, np.nan)
    mapping = map_rig(take.skeleton, seen, overrides)
    if not mapping.is_person:
        hint = "say in a map file which joint is which" if mapping.found else "is it a take of a person?"
        raise InputError("no human body was found among the joints", where=take.source, hint=hint)
    parts = ("upper_arm", "forearm", "thigh", "shin", "foot")
    limbs = [f"{side}_{part}" for side in ("left", "right") for part in parts]
    there = {name for name, joint in mapping.found.items() if take.motion.observed[frame, joint]}
    absent = [name for name in (["hips"] * (take.rig is not None) + limbs) if name not in there]
    if absent:
        few = ", ".join(absent[:4]) + (", …" if len(absent) > 4 else "")
        hint = "say in a map file which joint is which, or take another frame"
        raise InputError(f"frame {frame} has no {few}", where=take.source, expected="a whole person", hint=hint)
    return mapping


def _length(paths: Sequence[Trajectory], seconds: float | None, frames: int | None, fps: float) -> int:
    """Frames of the animation."""
    if seconds is not None and frames is not None:
        raise InputError("both seconds and frames say how long", hint="give one of them")
    longest = max((float(path.times[-1]) for path in paths), default=0.0)
    if frames is None and seconds is None:
        frames = math.ceil(longest * fps - 1e-6) + 1 if longest else round(SECONDS * fps)
    elif frames is None:
        frames = round(seconds * fps) if seconds is not None and math.isfinite(seconds) else 0
    if not 1 <= frames <= MOST:
        found = f"an animation of {frames} frames" if seconds is None else f"an animation of {seconds:g} s"
        raise InputError(found, expected=f"1 to {MOST:,} frames at {fps:g} fps")
    return frames


def _notes(held: Puppet, take: Take) -> tuple[str, ...]:
    lacking = ", ".join(held.lacking)
    guessed = f"the rig has no {lacking}: the network was told of such as a standing body has"
    return (*take.notes, guessed) if lacking else take.notes


@dataclass(frozen=True, eq=False)
class Asked:
    """A puppet and what is asked of it, at its own rate: `points (frames, J, 3)`, said where `given (frames, J)`.

    begins, joined : `(J,)` how far from the pose each path begins, metres, and the frames over which it is joined.
    """

    held: Puppet
    paths: tuple[Trajectory, ...]
    fps: float
    points: Array
    given: Array
    begins: Array
    joined: Array

    @classmethod
    def of(cls, held: Puppet, paths: Sequence[Trajectory], frames: int, fps: float) -> Asked:
        points, given = sampled(paths, frames, fps)
        began = given[0]
        begins = np.where(began, np.linalg.norm(points[0] - held.pose, axis=-1), 0.0)
        seconds = np.where(begins > TOLERANCE, np.maximum(JOIN, begins / PACE), 0.0)
        joined = np.minimum(np.ceil(seconds * fps), frames).astype(int)
        return cls(held, tuple(paths), fps, _led(points, given, held.pose, joined / fps, fps), given, begins, joined)

    def answered(
        self, completer: GenerativeCompleter, seed: Sequence[int], spread: float, again: Puppet | None, raw_paths: bool
    ) -> Array:
        """The network's own animation `(frames, J, 3)` metres, float64, at the puppet's rate.

        again : a puppet of two frames that mends the poses in which further windows begin; None leaves them.
        """
        frames, fps = len(self.points), completer.fps
        ours = math.ceil((frames - 1) * fps / self.fps) + 2
        points, given = sampled([path for path in self.paths if path.times[0] * fps < ours - 0.5], ours, fps)
        points = _led(points, given, self.held.pose, self.joined / self.fps, fps)
        points[0], given[0] = self.held.pose, True

        def restart(pose: Array, at: int) -> Array:
            assert again is not None
            asked = given[[0, at]] & (not raw_paths)
            asked[0] = False  # of the pose nothing is asked
            two = np.stack([self.held.pose, pose])
            two = carried(two, again.in_proportion(two), points[[0, at]], asked, fps)
            posed = meet(again, again.posed(two), two, points[[0, at]], asked, fps, steps=20)
            return np.where((again.joints >= 0)[:, None], posed.motion.positions[1, again.joints], pose)

        motion = Motion(points.astype(np.float32), given, fps, BODY)
        answer = completer.go_on(motion, seed, spread, restart if again else None)
        led = np.flatnonzero(given[1:].any(axis=0))
        if len(led) and not raw_paths:
            # Many networks give back a path as it is, and leave it with a jump where it ends.
            answer[:, led] = meet_seams(answer[:, led], answer[:, led], given[:, led], fps, FADE)
        try:
            whole = Motion(answer, np.ones(answer.shape[:2], bool), fps, BODY)
            own = windows.resample(whole, self.fps).positions[:frames].astype(float)
        except ValueError as error:
            raise InputError(str(error)) from None
        own[0] = self.held.pose
        return own

    def mended(self, own: Array, raw_paths: bool, raw_bones: bool, raw_floor: bool) -> Take:
        """The puppet posed as the network has it, its bones kept, the given paths met and a foot on the ground unless
        they are to be raw. Where paths say where the body is, they say how high it is too."""
        if not (raw_floor or leads(self.given)):
            own = grounded(own, above_ground(self._rigged(own), self.held.ground), self.fps, JOIN)
        real = own if raw_bones else self.held.in_proportion(own)
        wanted = own if raw_paths else carried(own, real, self.points, self.given, self.fps)
        if not raw_bones:
            posed = self.held.posed(wanted)
            given = self.given & (not raw_paths)
            return meet(self.held, posed, wanted, self.points, given, self.fps)
        rig = standing_rig(wanted, BODY, len(BODY))
        units = Units(self.held.take.units.metres, "y", self.held.take.units.why)
        free = np.ones(len(BODY), bool)
        take = Take(rig.motion(self.fps), rig, None, units, self.held.take.format, self.held.take.source)
        if not raw_paths:
            loose = Puppet(take, np.arange(len(BODY)), self.held.pose, free, rig.orders, 0)
            take = meet(loose, take, wanted, self.points, self.given, self.fps)
        return replace(take, rig=None)

    def _rigged(self, own: Array) -> Array:
        """`own (frames, J, 3)` with NaN for joints that the puppet's rig lacks: what is guessed stands nowhere."""
        return np.where((self.held.joints >= 0)[:, None], own, np.nan)

    def measured(self, number: int, own: Array, result: Take, completer: GenerativeCompleter, raw: bool) -> Variant:
        """What is to be said of a variant. own : the network's; result : the posed rig, or BODY's points if `raw`."""
        joints = np.arange(len(BODY)) if raw else self.held.joints
        now = result.motion.positions[:, joints].astype(float)
        now[:, joints < 0] = np.nan
        control = []
        for path in self.paths:
            at, (_, said) = path.joint, path.at(np.arange(len(own)) / self.fps, 0.5 / self.fps)
            begins, joined = (1000 * float(self.begins[at]), int(self.joined[at])) if said[0] else (0.0, 0)
            told = Controlled.of(path.name, self.points[:, at], said, own[:, at], now[:, at], joined)
            control.append(replace(told, part=BODY.names[at], begins=begins))
        bones, pose = self.held.bones, self.held.pose
        stretches = stretch(own, pose, bones), stretch(now, pose, bones)
        floors = off_ground(self._rigged(own), self.held.ground), off_ground(now, self.held.ground)
        ours = math.ceil((len(own) - 1) * completer.fps / self.fps) + 2
        starts = np.array(completer.starts(ours)[1:])
        first, last = (np.round(each * self.fps / completer.fps).astype(int).tolist()
                       for each in (starts, starts + completer.frames // 4))  # fmt: skip
        changes = [(start, stop) for start, stop in zip(first, last) if start < len(own)]
        return Variant(number, tuple(control), *stretches, *floors, Seam.of(now[:, joints >= 0], changes))


def _led(points: Array, given: Array, pose: Array, seconds: Array, fps: float) -> Array:
    """`points (frames, J, 3)`, the paths that begin elsewhere led out of the pose `(J, 3)` in `seconds (J,)` each."""
    out = points.copy()
    for joint in np.flatnonzero(seconds > 0):
        u = np.minimum(np.arange(len(points)) / (seconds[joint] * fps), 1)[:, None]
        ease = 1 - least_jerk(u)
        rows = given[:, joint]
        rows = rows & (np.cumsum(~rows) == 0)  # what begins later begins where it says
        out[rows, joint] += (ease * (pose[joint] - points[0, joint]))[rows]
    return out
