"""Which effects a comparison calls for: forward selection judged on held-out folds, and one backward pass."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import equinox as eqx
import numpy as np
import scipy.optimize
import scipy.stats
from jaxtyping import Bool, Float, Int

from ..._errors import InputError
from ...effects import AbstractEffect, Candidate
from ..settings import BEST, CONFIDENCE, DRAWS, EXPLAINED, LEAST_SHARE, LEVEL, MOST, RIVALS, STANDARD_ERROR, THE_SAME
from ..significance import covariance, family_wise, held_out, mean_squares, projector, summed, surely_positive
from .channel import AbstractChannel, Rows, State, acting

_SEED = 0
_STEPS = 20  # of the fit of a candidate that is tried


class FittedState(eqx.Module):
    """A state fitted to the rows of a channel: its `residual` and `slopes`, and what is `left` of rows of folds that a
    fit did not see."""

    state: State
    residual: Rows
    slopes: Float[np.ndarray, "row free"]
    left: Rows


class TriedCandidate(eqx.Module):
    """A candidate beside what has been found.

    **Fields:** `values`: of its coefficients; `part`: of the residual, that it explains; `explained`: of its power.
    `left`: of rows that the fit did not see, `squares`: their mean in every block. `share`: of the reducible gap where
    it acts, that it takes away on them; `sure`: whether it surely
    takes any, and enough. `matters`: whether it is more than the `smallest` of its channel.
    """

    candidate: Candidate
    values: tuple[float, ...]
    part: Rows
    explained: float
    left: Rows
    squares: Float[np.ndarray, "block"]
    p_value: float
    share: float
    sensible: bool
    sure: bool
    matters: bool

    @property
    def accepted(self) -> bool:
        shows = self.p_value <= LEVEL and self.matters
        return shows and self.sensible and self.sure and self.share >= LEAST_SHARE

    @property
    def why(self) -> str:
        """Why it is named or not, if it is the best."""
        if self.p_value > LEVEL:
            return "no more than chance explains"
        if not self.matters:
            return "too little to matter"
        if not self.sensible:
            return "a sign or size that no such effect has"
        if not self.sure or self.share < LEAST_SHARE:
            return f"takes {max(self.share, 0.0):.0%} of what could be explained where nothing was fitted"
        return ""


class Found(eqx.Module):
    """A trial that was taken, `equivalent` ones, and whether these make it `ambiguous`."""

    trial: TriedCandidate
    equivalent: tuple[str, ...]
    ambiguous: bool


class ChannelSelection(eqx.Module):
    """What a search found: `base` without and `fitted` with the effects; `trials`: all candidates at the first step,
    the best of each effect and joint, best first; `refused`, `last_p`: at the last one, `last_p` of those that matter.
    `floor`: of the base.
    `left_out`: name -> why."""

    base: FittedState
    fitted: FittedState
    found: tuple[Found, ...]
    trials: tuple[TriedCandidate, ...]
    refused: tuple[TriedCandidate, ...]
    last_p: float
    floor: Rows
    left_out: dict[str, str]


def refitted(channel: AbstractChannel, state: State, steps: int = 60) -> FittedState:
    """All free values by least squares, in so many steps at most."""
    if state.values.size:
        worst = 1e3 * channel.measured

        def left(x):
            try:
                with np.errstate(all="ignore"):
                    r = channel.residual(state.at(x))
            except InputError:  # no such effect
                return worst
            return r if np.all(np.isfinite(r)) else worst

        low, high = state.bounds
        found = scipy.optimize.least_squares(
            left,
            np.clip(state.values, low, high),
            lambda x: -channel.slopes(state.at(x)),
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-10,
            max_nfev=steps,
        )
        state = state.at(found.x)
    r, S = channel.residual(state), channel.slopes(state)
    return FittedState(state, r, S, held_out(S, r, channel.fold))


def search(channel: AbstractChannel, kinds: Sequence[type[AbstractEffect]]) -> ChannelSelection:
    """Effect by effect, the best first; or, where that takes one on its way that is not what it is called, such ones
    for want of others only: what leaves less."""
    found, all_believed = _search(channel, kinds, False)
    if all_believed:
        return found
    other, _ = _search(channel, kinds, True)
    return min((other, found), key=lambda x: float(np.mean(x.fitted.left**2)))


def _search(channel: AbstractChannel, kinds, believed_first: bool) -> tuple[ChannelSelection, bool]:
    """Base fit, then effect by effect while one is accepted, `MOST` at most; then needless ones are taken out again.
    Also: whether all that were taken were what they are called."""
    all_believed = True
    now = base = refitted(channel, State(channel.robot, channel.own()))
    whole, left_out = _pool(channel, kinds)
    pool = whole
    found: list[Found] = []
    first: tuple[TriedCandidate, ...] = ()
    floor = channel.floor(base.residual)
    for step in range(MOST * channel.n_parts + 1):
        trials = _trials(channel, now, pool, floor if now is base else None, _SEED + step)
        if step == 0:
            seen = {t.candidate.name for t in trials}
            left_out |= {c.name: "it does not show in this comparison" for c in pool if c.name not in seen}
            first = trials
        good = [t for t in _best(trials) if t.accepted]
        if not good or step == MOST * channel.n_parts:
            break
        believed = [t for t in good if _effect(t.candidate, t.values).believable]
        best = _simplest(believed or good if believed_first else good, float(np.mean(now.left**2)), channel.tie)
        all_believed &= any(best.trial is t for t in believed)
        found.append(best)
        now = refitted(channel, now.state.having(best.trial.candidate, best.trial.values))
        now = _exchanged(channel, now, whole)
        found = [_called(one, candidate) for one, (candidate, _) in zip(found, now.state.chosen, strict=True)]
        pool = [c for c in whole if c.key not in {chosen.key for chosen, _ in now.state.chosen}]
    refused = tuple(t for t in _best(trials) if not t.accepted)
    now, kept = _backward(channel, now)
    last_p = min((t.p_value for t in trials if t.matters), default=1.0)
    return ChannelSelection(
        base, now, tuple(found[i] for i in kept), first, refused, last_p, floor, left_out
    ), all_believed


def _effect(candidate: Candidate, values: Iterable[float]) -> AbstractEffect:
    return candidate.make(np.array(values))


def _pool(channel: AbstractChannel, kinds) -> tuple[list[Candidate], dict[str, str]]:
    found: list[Candidate] = []
    left_out = {}
    for kind in kinds:
        new: list[Candidate] = []
        for joint in channel.robot.axis_names:
            try:
                new += channel.tried(kind, joint)
            except InputError as error:
                left_out[kind.name] = str(error)
        if new:
            left_out.pop(kind.name, None)
        found += new
    return found, left_out


def _trials(
    channel: AbstractChannel, now: FittedState, pool: Sequence[Candidate], floor: Rows | None, seed: int
) -> tuple[TriedCandidate, ...]:
    """All candidates that show, the best variant of each effect and joint, by what they explain."""
    r, block, project = now.residual, channel.blocks(now.residual), projector(now.slopes)
    whole = max(float(np.sum(r**2)), 1e-300)
    tried = _lines(channel, now, pool, project) if channel.linear else _fits(channel, now, pool, project)
    made = [x for x in tried if np.any(x[1])]
    p = family_wise([summed(evidence, block) for *_, evidence in made], DRAWS, seed, not channel.linear)
    before = mean_squares(now.left, block)
    if floor is None:
        floor = channel.floor(r) if np.any(p <= LEVEL) else np.zeros_like(r)
    trials: dict[tuple[str, str], TriedCandidate] = {}
    for candidate, columns, values, part, left, p_value in (
        (*one[:-1], float(q)) for one, q in zip(made, p, strict=True)
    ):
        here, squares = acting(columns, channel.group), mean_squares(left, block)
        reducible = np.mean(now.left[here] ** 2) - np.mean(floor[here] ** 2)
        trial = TriedCandidate(
            candidate,
            tuple(float(v) for v in values),
            part,
            float(1.0 - np.sum((r - part) ** 2) / whole),
            left,
            squares,
            p_value,
            float(np.mean(now.left[here] ** 2 - left[here] ** 2) / reducible) if reducible > 0.0 else 0.0,
            channel.sensible(candidate, values),
            _relative(channel, left, here) <= (1.0 - channel.least_drop) * _relative(channel, now.left, here)
            and surely_positive(before - squares),
            float(np.mean(part[here] ** 2)) >= channel.smallest**2 * float(np.mean(channel.measured[here] ** 2)),
        )
        other = trials.get(candidate.key)
        if other is None or (trial.sensible, trial.explained) > (other.sensible, other.explained):
            trials[candidate.key] = trial
    return tuple(sorted(trials.values(), key=lambda t: -t.explained))


Made = tuple[
    Candidate, Float[np.ndarray, "row free"], Float[np.ndarray, "free"], Rows, Rows, Float[np.ndarray, "row k"]
]
"""A candidate, its columns and coefficients, what they explain, what is left of rows that no fit saw, and the evidence
of every row."""


def _lines(channel: AbstractChannel, now: FittedState, pool: Sequence[Candidate], project) -> Iterator[Made]:
    """Every candidate by one linear step."""
    r = now.residual
    for candidate, P in zip(pool, channel.columns(now.state, pool), strict=True):
        own = project(P)
        size = np.linalg.norm(own, axis=0)
        if np.any(size**2 <= THE_SAME * np.sum(P**2, axis=0)):  # one of the free numbers
            yield candidate, P, np.zeros(P.shape[1]), np.zeros_like(r), now.left, np.zeros_like(P)
            continue
        values = np.linalg.lstsq(own / size, r, rcond=1e-8)[0] / size
        left = held_out(np.concatenate([now.slopes, P], axis=1), r, channel.fold)
        yield candidate, P, values, own @ values, left, own / size * r[:, None]


def _fits(channel: AbstractChannel, now: FittedState, pool: Sequence[Candidate], project) -> list[Made]:
    """Every candidate by a fit of all that is free; variants are its starts, of which the best counts."""
    best: dict[tuple[str, str], tuple[tuple[bool, float], Made]] = {}
    for candidate in pool:
        start = candidate.start or tuple(1.0 for _ in candidate.basis)
        P = (channel.predicted(now.state.having(candidate, start)) - channel.predicted(now.state))[:, None]
        values, part, left = np.array(start), np.zeros_like(now.residual), now.left
        if np.sum(project(P) ** 2) > THE_SAME * np.sum(P**2):
            fit = refitted(channel, now.state.having(candidate, start), _STEPS)
            values, part, left = np.array(fit.state.chosen[-1][1]), now.residual - fit.residual, fit.left
        rank = channel.sensible(candidate, values), -float(np.sum((now.residual - part) ** 2))
        if candidate.key not in best or rank > best[candidate.key][0]:
            best[candidate.key] = rank, (candidate, P, values, part, left, (now.left**2 - left**2)[:, None])
    return [made for _, made in best.values()]


def _relative(channel: AbstractChannel, left: Rows, here: Bool[np.ndarray, "row"]) -> float:
    """Power left over what was measured, each fold alike."""
    parts = [here & (channel.fold == k) for k in np.unique(channel.fold)]
    return float(np.mean([np.mean(left[x] ** 2) / np.mean(channel.measured[x] ** 2) for x in parts]))


def _best(trials: Sequence[TriedCandidate]) -> list[TriedCandidate]:
    return [t for t in trials if t.p_value <= LEVEL][:BEST]


def _simplest(good: list[TriedCandidate], before: float, tie: float) -> Found:
    """The best trial, or one with fewer parameters that is as good; and what cannot be told from it.

    As good: within a standard error, or within `tie` of what the best takes away. What explains exactly the same is the
    same law under another name, and makes nothing ambiguous."""
    best = min(good, key=lambda t: np.mean(t.squares))
    least = before - (1.0 - tie) * (before - np.mean(best.squares))
    as_good = lambda t: (
        np.mean(t.squares) < least or not surely_positive(t.squares - best.squares, level=STANDARD_ERROR)
    )
    level = [t for t in good if as_good(t) and _cosine(t.part, best.part) > RIVALS]
    chosen = min(level, key=lambda t: (len(t.values), np.mean(t.squares)))
    others = [t for t in level if t is not chosen]
    ambiguous = any(
        len(t.values) <= len(chosen.values) and _cosine(t.part, chosen.part) < 1.0 - THE_SAME for t in others
    )
    return Found(chosen, tuple(dict.fromkeys(t.candidate.name for t in others)), ambiguous)


def _cosine(a: Rows, b: Rows) -> float:
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def _exchanged(channel: AbstractChannel, now: FittedState, pool: Sequence[Candidate]) -> FittedState:
    """Effects in whose place one that looks like it leaves less, beside those that were found after it."""
    for i, (chosen, values) in enumerate(now.state.chosen):
        for other in pool:
            if other.key == chosen.key or not _one_class(other, chosen) or len(other.basis) != len(chosen.basis):
                continue
            fit = refitted(channel, now.state.replaced(i, other, values))
            effect, found = fit.state.chosen[i]
            sensible = channel.sensible(effect, np.asarray(found))
            if sensible and np.mean(fit.left**2) < np.mean(now.left**2):
                now = fit
    return now


def _called(found: Found, candidate: Candidate) -> Found:
    """The same, of the candidate that took its place."""
    old = found.trial.candidate
    if old.key == candidate.key:
        return found
    alike = dict.fromkeys([old.name, *(name for name in found.equivalent if name != candidate.name)])
    return Found(dataclasses.replace(found.trial, candidate=candidate), tuple(alike), found.ambiguous)


def _one_class(candidate: Candidate, other: Candidate) -> bool:
    """Whether both are one effect, or most data cannot tell them apart, on the same joint."""
    effect = other.make(np.array(other.start or [1.0] * len(other.basis)))
    return candidate.joint == other.joint and candidate.name in (other.name, *effect.alike, *effect.same_law)


def _backward(channel: AbstractChannel, now: FittedState) -> tuple[FittedState, list[int]]:
    """Effects that the others have made needless or senseless, or whose interval holds none of them, are taken out
    again; not for that interval, where without them much would be left: it is a local one."""
    kept = list(range(len(now.state.chosen)))
    for i in reversed(range(len(now.state.chosen))):
        at = kept.index(i)
        fewer, block = refitted(channel, now.state.without(at)), channel.blocks(now.residual)
        gain = mean_squares(fewer.left, block) - mean_squares(now.left, block)
        needless = len(kept) > 1 and not surely_positive(gain)
        much = np.mean(now.left**2) < (1.0 - EXPLAINED) * np.mean(fewer.left**2)  # and numbers that give way soften it
        none = not much and _holds_none(channel, now, at)
        if needless or none or _senseless(channel, *now.state.chosen[at]):
            now = fewer
            kept.remove(i)
    return now, kept


def _senseless(channel: AbstractChannel, candidate: Candidate, values) -> bool:
    return not (channel.sensible(candidate, np.array(values)) and _effect(candidate, values).believable)


def _holds_none(channel: AbstractChannel, fit: FittedState, i: int) -> bool:
    """Whether the joint 95 % interval of the effect's coefficients holds zeros, for those that are linear in them."""
    candidate, values = fit.state.chosen[i]
    if candidate.start:
        return False
    here = fit.state.place(i)
    V = spread(channel, fit)[here, here]
    distance = np.array(values) @ np.linalg.pinv(V, hermitian=True) @ np.array(values)
    return bool(distance < scipy.stats.chi2.ppf(CONFIDENCE, len(values)))


def spread(channel: AbstractChannel, fit: FittedState) -> Float[np.ndarray, "free free"]:
    """Covariance of all that is free, from the scatter between blocks."""
    block: Int[np.ndarray, row] = channel.blocks(fit.residual)
    return covariance(fit.residual, fit.slopes, block)
