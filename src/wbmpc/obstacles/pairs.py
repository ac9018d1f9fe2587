"""Which parts of a robot can touch each other: proposed by sampling, for a person to confirm in the robot file."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.collider import Collider
from wbmpc.obstacles.geometry import RobotGeometry, path_of, rigid_link, robot_geometry
from wbmpc.robots.findings import Finding

Pair = tuple[str, str]
#: States that are drawn, and the distance [m] beyond which a pair is not near.
SAMPLES, NEAR = 600, 0.10
#: Share of the states in which a pair that is nearer than its margin is taken for one that always is: nothing can keep it apart.
ALWAYS = 0.95
#: Of the pairs for a robot file: states that are drawn, the share of them in which a pair may be nearer than its margin, and how many
#: pairs there are at most: each costs time in every solve.
FILE_SAMPLES, OFTEN, MAX_PAIRS = 4000, 0.5, 20
#: Bounds of pairs of shapes that are made in all and at a time, and distances that are computed, at most: a model of hundreds of
#: shapes is sampled in fewer states. One beyond so many shapes is not.
MAX_BOUNDS, AT_ONCE, MAX_EXACT, MAX_SHAPES = 10_000_000, 1_000_000, 300_000, 1000
#: Of a robot file's pairs it is looked in at most so many states, and in fewer where shapes are many, whether others touch.
LOOKED_AT, LOOKED_AT_BOUNDS = 1000, 400_000
#: Of those so many are named with how often; what touches in a smaller share of the states is no fault: a pair costs time in every solve.
NAMED, RARE = 5, 0.02
#: Shapes that are nearer [m] overlap.
TOUCHING = 1e-6
#: A pair keeps no margin at home of which less than this share is left, or that share of its distance there where that is less.
HOME_SHARE = 0.5


@dataclass(frozen=True)
class Proposal:
    """Pairs of frames by what sampling ``samples`` states found of them: ``pairs`` that come near; ``adjacent``: one joint or none between
    them, or sections of one telescope; ``always``: nearer than their margin in almost every state, or touching at home; ``never``: not
    nearer than :data:`NEAR` in any, which is no proof."""

    samples: int
    pairs: tuple[Pair, ...]
    adjacent: tuple[Pair, ...]
    always: tuple[Pair, ...]
    never: tuple[Pair, ...]


def draw_states(robot: RobotModel, count: int, seed: int = 0) -> Array:
    """States (count, nx) within the ranges of joints, the first one home; what has no range stays at home, but for joints of the arm."""
    limits, rng = robot.limits, np.random.default_rng(seed)
    lower, upper = limits.state_lower.copy(), limits.state_upper.copy()
    arm = np.zeros(robot.state.size, bool)
    arm[robot.state["arm"]] = True
    lower[arm & ~np.isfinite(lower)], upper[arm & ~np.isfinite(upper)] = -np.pi, np.pi
    free = np.isfinite(lower) & np.isfinite(upper)
    states = np.tile(robot.home, (count, 1))
    states[1:, free] = rng.uniform(lower[free], upper[free], (count - 1, int(free.sum())))
    return states


def propose_pairs(robot: RobotModel, samples: int = SAMPLES) -> Proposal:
    """Which pairs of frames a robot has to keep apart, from ``samples`` random states."""
    geometry = robot_geometry(robot)
    adjacent = [p for p in combinations(_bodies(geometry), 2) if _adjacent(robot, *p)]
    known = {*adjacent}
    others = [p for p in combinations(_bodies(geometry), 2) if p not in known]
    minimum = distances(geometry, others, draw_states(robot, samples))
    always = (minimum < robot.description.collision.self.margin).mean(axis=0) >= ALWAYS
    always |= minimum[0] < 0.0
    never = ~always & (minimum >= NEAR).all(axis=0)
    listed = lambda mask: tuple(p for p, m in zip(others, mask, strict=True) if m)
    return Proposal(len(minimum), listed(~always & ~never), tuple(adjacent), listed(always), listed(never))


@dataclass(frozen=True)
class Listing:
    """Pairs for a robot file by what sampling found nearer than their margins: ``pairs`` that can come so near, first those without which
    most states would be missed (:func:`_in_order`); ``rare``: the last ones, beyond :data:`MAX_PAIRS`; ``missed``: share of the states with
    any pair too near in which it is only these; ``close``: touching at home, where nothing can keep them apart;
    ``drawn``: those that overlap in most states, so that it is their shapes which do, and not the parts; ``samples``: states that were
    drawn."""

    pairs: tuple[Pair, ...]
    rare: tuple[Pair, ...]
    close: tuple[Pair, ...]
    drawn: tuple[Pair, ...]
    samples: int
    missed: float = 0.0


def _in_order(hits: NDArray[np.bool_]) -> list[int]:
    """Pairs by ``hits`` (n, pairs), whether they are too near in states: each next one is that which is in most of the states in which
    none before it is; where there are none left, the most frequent. How often a pair is near says little: parts that come near together
    make many frequent pairs, any of which keeps them apart, and others are near in their own few postures."""
    order, left, free = list[int](), np.array(hits.any(axis=1)), np.array(hits.any(axis=0))
    often = hits.sum(axis=0)
    while free.any():
        new = hits[left].sum(axis=0)
        best = int(np.lexsort((-often, -new, ~free))[0])
        order.append(best)
        free[best] = False
        left = left & ~hits[:, best]
    return order


def list_pairs(robot: RobotModel, samples: int = FILE_SAMPLES) -> Listing:
    """What a robot file should say of ``collision.self.pairs``. Raises :class:`~wbmpc.errors.InputError` for a robot without shapes."""
    geometry, margin = robot_geometry(robot), robot.description.collision.self.margin
    pairs = [p for p in combinations(_bodies(geometry), 2) if not _adjacent(robot, *p)]
    apart = distances(geometry, pairs, draw_states(robot, samples), max((1.0 + HOME_SHARE) * margin, TOUCHING))
    close, drawn = apart[0] < TOUCHING, (apart < TOUCHING).mean(axis=0) >= OFTEN
    close |= drawn
    hits = (apart < _kept(apart[0], margin)) & ~close
    order = _in_order(hits)
    named, any_near = [pairs[i] for i in order], hits.any(axis=1)
    missed = any_near & ~hits[:, order[:MAX_PAIRS]].any(axis=1)
    listed = lambda mask: tuple(pairs[i] for i in np.flatnonzero(mask))
    return Listing(
        tuple(named[:MAX_PAIRS]), tuple(named[MAX_PAIRS:]), listed(close & ~drawn), listed(drawn), len(apart),
        float(missed.sum() / max(any_near.sum(), 1)),
    )  # fmt: skip


def own_margins(robot: RobotModel, pairs: Sequence[Pair], margin: float) -> Array:
    """What each pair keeps (pairs) [m]: ``margin``, or of one that is near at home so much that home is clear by :data:`HOME_SHARE` of it:
    the simulation lets it collide like any other. Parts that joints turn beside their axes are as far from each other in most postures as
    at home, and a margin of as much would hold their row at its limit. One that touches at home has the whole margin."""
    reach = max((1.0 + HOME_SHARE) * margin, TOUCHING)
    return _kept(distances(robot_geometry(robot), list(pairs), robot.home[None], reach)[0], margin)


def _kept(at_home: Array, margin: float) -> Array:
    """The same by distances (pairs) [m] at home."""
    clear = np.minimum(margin, at_home / (1.0 + HOME_SHARE))
    return np.where(at_home < TOUCHING, margin, clear)


def distances(geometry: RobotGeometry, pairs: list[Pair], states: Array, reach: float = NEAR) -> Array:
    """Least distances (k, pairs) [m] of pairs of frames at the first k of ``states`` (n, nx); ``reach`` where it is more. All n but
    for a robot of so many shapes, or so many that are near each other, that it would take long.

    Raises :class:`~wbmpc.errors.InputError` for more than :data:`MAX_SHAPES` shapes.
    """
    count = len(geometry.shapes)
    if count > MAX_SHAPES:
        raise InputError(f"the robot has {count} shapes; at most {MAX_SHAPES} are compared with each other")
    collider = Collider([s.solid for s in geometry.shapes])
    of = {f: geometry.fixed_to(f) for f in {f for pair in pairs for f in pair}}
    listed = [(p, i, j) for p, (a, b) in enumerate(pairs) for i in of[a] for j in of[b]]
    row, first, second = table = np.array(listed, int).reshape(-1, 3).T
    states = states[: max(MAX_BOUNDS // count**2, 1)]
    found, part, left = np.full((len(states), len(pairs)), reach), max(AT_ONCE // count**2, 1), MAX_EXACT
    for start in range(0, len(states), part):
        centers, axes = geometry.at(*geometry.kinematics(states[start : start + part]))
        bound = _bounds(geometry, centers, axes, table[1:], reach)
        for k in range(len(bound)):
            if left <= 0:
                return found[: start + k]
            near = np.flatnonzero(bound[k] < reach).tolist()
            if near:
                collider.place(centers[k], axes[k])
            left -= len(near)
            for i in near:
                best = found[start + k, row[i]]
                if bound[k, i] < best:
                    exact = collider.distance(int(first[i]), int(second[i]), float(best))
                    found[start + k, row[i]] = min(best, exact)
    return found


def _bounds(geometry: RobotGeometry, centers: Array, axes: Array, ends: NDArray[np.int64], reach: float) -> Array:
    """At most the distances (n, pairs) [m] of pairs of shapes, whose numbers are ``ends`` (2, pairs): of their spheres, and where these are
    nearer than ``reach`` of each shape against the sphere around the other."""
    apart = centers[:, ends[0]] - centers[:, ends[1]]
    bound = np.sqrt(np.einsum("npi,npi->np", apart, apart)) - geometry.radius[ends].sum(axis=0)
    state, pair = np.nonzero(bound < reach)
    for one, other in (ends[:, pair], ends[::-1, pair]):
        order = np.argsort(one, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(one[order])) + 1):
            if part.size:
                k, c, far = state[part], one[part[0]], other[part]
                seen = np.einsum("ni,nij->nj", centers[k, far] - centers[k, c], axes[k, c])
                found = geometry.shapes[c].solid.distance(seen) - geometry.radius[far]
                bound[k, pair[part]] = np.maximum(bound[k, pair[part]], found)
    return bound


def _bodies(geometry: RobotGeometry) -> list[str]:
    """One frame for each of the robot's rigid parts: the one on its joint if it has shapes, else that with the largest."""
    robot, named = geometry.robot, dict[int, str]()
    extent = dict(zip(geometry.frames, geometry.extent, strict=True))
    for frame in geometry.frames:
        link = rigid_link(robot, frame)
        own = robot.tree.links[link].name
        if link not in named or frame == own or (named[link] != own and extent[frame] > extent[named[link]]):
            named[link] = frame
    return list(named.values())


def _adjacent(robot: RobotModel, a: str, b: str) -> bool:
    """Whether at most one joint moves a frame against another, or they are sections of one telescope, which go into each other."""
    tree = robot.tree
    above, below = sorted((path_of(robot, tree.frames[f].link) for f in (a, b)), key=len)
    between = set(above) ^ set(below)
    moving = [i for i in (*above, *below) if i in between and tree.links[i].joint is not None]
    return all(tree.section_before(link) == before for before, link in pairwise(moving))


_PROPOSALS: WeakKeyDictionary[RobotModel, Proposal] = WeakKeyDictionary()
_LOCK = threading.RLock()  # a signal's handler may come in the middle


def proposal_of(robot: RobotModel) -> Proposal:
    """:func:`propose_pairs`, once for a robot."""
    with _LOCK:
        if robot not in _PROPOSALS:
            _PROPOSALS[robot] = propose_pairs(robot)
        return _PROPOSALS[robot]


def self_pairs(robot: RobotModel) -> tuple[Pair, ...]:
    """The pairs that the robot file names, or those that are proposed, without the ones to ignore."""
    own = robot.description.collision.self
    found = proposal_of(robot).pairs if own.pairs is None else own.pairs
    ignored = {frozenset(p) for p in own.ignore}
    return tuple(p for p in found if frozenset(p) not in ignored)


def arm_pairs(robot: RobotModel) -> tuple[Pair, ...]:
    """Those of :func:`self_pairs` in which no part hangs on a joint of the base: what the arm can run into by itself."""
    moving = {robot.tree.joint(n) for n in robot.description.base.joints() if n in {k.joint for k in robot.tree.links}}
    frames = robot.tree.frames
    still = lambda name: moving.isdisjoint(path_of(robot, frames[name].link))
    return tuple((a, b) for a, b in self_pairs(robot) if still(a) and still(b))


class Unlisted(NamedTuple):
    """Of ``drawn`` states, the first of which is home, ``counted`` are those beside home in which all listed pairs keep their margins;
    ``never``: listed ones that do in none; ``pairs``: that are not listed and touch in states that count, with how many of them."""

    drawn: int
    counted: int
    never: tuple[Pair, ...]
    pairs: dict[Pair, int]


def unlisted(robot: RobotModel, seed: int = 1) -> Unlisted:
    """Pairs that touch and that :func:`self_pairs` does not have. Not those that the robot file ignores or that touch at home or in most
    states."""
    geometry, own = robot_geometry(robot), robot.description.collision.self
    key = lambda pair: frozenset(rigid_link(robot, frame) for frame in pair)
    listed = list(self_pairs(robot))
    known = {key(pair) for pair in (*listed, *own.ignore)}
    others = [p for p in combinations(_bodies(geometry), 2) if key(p) not in known and not _adjacent(robot, *p)]
    count = min(LOOKED_AT, max(LOOKED_AT_BOUNDS // len(geometry.shapes) ** 2, 2))
    reach = max((1.0 + HOME_SHARE) * own.margin, TOUCHING)
    apart = distances(geometry, listed + others, draw_states(robot, count, seed), reach)
    keeps = (apart >= _kept(apart[0], own.margin))[:, : len(listed)]
    kept, never = np.array(keeps.all(axis=1)), ~keeps[1:].any(axis=0) & (len(apart) > 1)
    touching = np.asarray(apart[:, len(listed) :] < TOUCHING)
    drawn = touching[0] | (touching.mean(axis=0) >= OFTEN)
    often = (touching & kept[:, None] & ~drawn).sum(axis=0)
    pairs = {others[i]: int(often[i]) for i in np.argsort(-often, kind="stable") if often[i]}
    return Unlisted(len(apart), int(kept[1:].sum()), tuple(listed[i] for i in np.flatnonzero(never)), pairs)


def diagnose(robot: RobotModel) -> Iterator[Finding]:
    """What of its own a robot keeps apart, for a person to confirm."""
    geometry, own = robot_geometry(robot), robot.description.collision.self
    bare = [b for b in robot.frames if b not in geometry.frames and b in _links(robot)]
    yield Finding(
        "info", "collision", "key 'collision.shapes'", f"{len(geometry.shapes)} shapes on {len(geometry.frames)} frames"
        + (f"; none on {', '.join(bare)}" if bare else ""), "",
    )  # fmt: skip
    if own.pairs is not None:
        yield Finding(
            "info", "collision", "key 'collision.self.pairs'", f"{len(self_pairs(robot))} pairs, confirmed", ""
        )
        yield from _missing(robot)
        return
    found = proposal_of(robot)
    pairs = ", ".join(f"[{a}, {b}]" for a, b in self_pairs(robot))
    touching = ", ".join(f"[{a}, {b}]" for a, b in found.always)
    yield Finding(
        "info", "collision", "key 'collision.self.pairs'",
        f"{len(self_pairs(robot))} pairs come near in {found.samples} random states ({len(found.adjacent)} adjacent and "
        f"{len(found.never)} others do not)" + (f"; these touch at home or are always near and are left out: {touching}" if touching else ""),
        f"confirm them: collision: {{self: {{pairs: [{pairs}]}}}}",
    )  # fmt: skip


def _missing(robot: RobotModel) -> Iterator[Finding]:
    """Warnings where parts touch that no pair of the robot file keeps apart, and where that cannot be said; a note of those that touch
    in a share of the states below :data:`RARE`."""
    looked = unlisted(robot)
    found = {pair: n for pair, n in looked.pairs.items() if n >= RARE * looked.counted}
    rare = [pair for pair in looked.pairs if pair not in found]
    if not looked.counted:
        never = ", ".join(f"[{a}, {b}]" for a, b in looked.never)
        yield Finding(
            "warning", "collision", "key 'collision.self.pairs'",
            f"not known whether parts touch that no pair keeps apart: in none of {looked.drawn - 1} random states all pairs keep their margin"
            + (f"; these never do: {never}" if never else ""),
            "remove pairs that nothing can keep apart, or lower 'collision.self.margin'" if never else "",
        )  # fmt: skip
    if found:
        often = ", ".join(f"[{a}, {b}] in {n}" for (a, b), n in list(found.items())[:NAMED])
        more = f" and {len(found) - NAMED} others" if len(found) > NAMED else ""
        pairs = ", ".join(f"[{a}, {b}]" for a, b in found)
        yield Finding(
            "warning", "collision", "key 'collision.self.pairs'",
            f"parts touch that no pair keeps apart, of {looked.counted} random states in which those of the file are apart {often}{more}",
            f"add them to 'collision.self.pairs', or to 'collision.self.ignore' where only their shapes touch: [{pairs}]",
        )  # fmt: skip
    if rare:
        pairs = ", ".join(f"[{a}, {b}]" for a, b in rare)
        yield Finding(
            "info", "collision", "key 'collision.self.pairs'",
            f"parts touch that no pair keeps apart, each pair in less than {RARE:.0%} of {looked.counted} random states: {pairs}",
            "leave them out, as each pair costs time in every solve, or add those that your tasks bring near each other",
        )  # fmt: skip


def _links(robot: RobotModel) -> set[str]:
    return {link.name for link in robot.tree.links}
