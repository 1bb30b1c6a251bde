"""Forward selection of effects, judged on held-out stretches, and one backward pass."""

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Float

from .torque_candidates import Candidate, allowed
from .torque_evidence import Evidence, Fitted, cross_validated
from .torque_model import needed_torque
from .torque_result import Ranked
from .torque_score import family_wise, projector, score

LEVEL = 0.05  # family-wise
_LEAST_DROP = 0.2  # of the reducible gap, that an effect must take away
_TIE = 0.05  # of it, within which fewer parameters win
_RIVALS = 0.7  # cosine
_BEST = 5  # classes that are refitted


class Trial(eqx.Module):
    """A candidate refitted in full: `after`, mean square on every held-out stretch; `share` of the reducible gap."""

    candidate: Candidate
    values: tuple[float, ...]
    part: Float[np.ndarray, "row"]  # of the residual, that it explains
    p_value: float
    before: np.ndarray
    after: np.ndarray
    share: float
    sensible: bool

    @property
    def accepted(self) -> bool:
        return self.sensible and surely_positive(self.before - self.after) and self.share >= _LEAST_DROP


class Search(eqx.Module):
    fitted: Fitted
    found: tuple[tuple[Trial, tuple[str, ...], bool], ...]  # trial, equivalents, ambiguous
    ranking: tuple[Ranked, ...]
    last_p: float
    refused: tuple[Trial, ...]


def search(evidence: Evidence, base: Fitted, pool, most: int, draws: int, seed: int) -> Search:
    now, found, ranking, refused, last_p = base, [], (), (), 1.0
    for step in range(most + 1):
        trials, ranked = _step(evidence, now, pool, draws, seed + step)
        ranking = ranked if step == 0 else ranking
        last_p = min((x.p_value for x in ranked), default=1.0)
        good = [x for x in trials if x.accepted]
        refused = tuple(x for x in trials if not x.accepted)
        if not good or step == most:
            break
        best, equivalent, ambiguous = _simplest(good)
        found.append((best, equivalent, ambiguous))
        now = evidence.refitted(now.state.having(best.candidate, best.values))
        pool = [c for c in pool if (c.name, c.joint) != (best.candidate.name, best.candidate.joint)]
    now, kept = _backward(evidence, now)
    return Search(now, tuple(found[i] for i in kept), ranking, last_p, refused)


def _step(evidence: Evidence, now: Fitted, pool, draws: int, seed: int):
    """Score all candidates, refit the best classes."""
    robot, r, S = now.state.robot(), now.residual, now.slopes
    project, block = projector(S), evidence.blocks(r)
    needed = [needed_torque(robot, m) for m in evidence.motions]
    columns = [evidence.columns(robot, c, needed) for c in pool]
    scores = [score(r, P, project, block) for P in columns]
    p = family_wise(scores, draws, seed)
    ranked, best = [], []
    for i in sorted(range(len(pool)), key=lambda i: -scores[i].explained):
        key = (pool[i].name, pool[i].joint)
        if key in [(x.name, x.joint) for x in ranked]:
            continue
        ranked.append(Ranked(*key, scores[i].explained, float(p[i])))
        if p[i] <= LEVEL and len(best) < _BEST:
            best.append(i)
    before = now.squares
    reducible = np.mean(before) - evidence.floor(r) ** 2 if best else 0.0
    trials = []
    for i in best:
        after = cross_validated(np.concatenate([S, columns[i]], axis=1), r, evidence.of_rows())
        share = float((np.mean(before) - np.mean(after)) / max(reducible, 1e-300))
        values, limit = tuple(map(float, scores[i].change)), evidence.size.max() * np.abs(evidence.torque).max()
        sensible = allowed(pool[i], scores[i].change, robot, float(limit))
        trials.append(
            Trial(pool[i], values, project(columns[i] @ scores[i].change), float(p[i]), before, after, share, sensible)
        )
    return trials, tuple(ranked)


def _simplest(good: list[Trial]):
    """The best trial, or one with fewer parameters that is as good; and what cannot be told from it.

    As good: within a standard error, or within a twentieth of the reducible gap (more parameters always gain a little).
    """
    best = min(good, key=lambda x: np.mean(x.after))
    as_good = lambda x: best.share - x.share < _TIE or not surely_positive(x.after - best.after, level=0.84)
    level = [x for x in good if as_good(x) and _alike(x.part, best.part)]
    chosen = min(level, key=lambda x: (len(x.candidate.free), np.mean(x.after)))
    others = [x for x in level if x is not chosen]
    ambiguous = any(len(x.candidate.free) <= len(chosen.candidate.free) for x in others)
    return chosen, tuple(dict.fromkeys(x.candidate.name for x in others)), ambiguous


def _alike(a, b) -> bool:
    """Whether two effects explain the same: those that do not are no rivals, each may be missing."""
    return bool(a @ b > _RIVALS * np.linalg.norm(a) * np.linalg.norm(b))


def surely_positive(drop: Float[np.ndarray, "stretch"], level: float = 0.95) -> bool:
    n = len(drop)
    return bool(np.mean(drop) > scipy.stats.t.ppf(level, n - 1) * np.std(drop, ddof=1) / np.sqrt(n))


def _backward(evidence: Evidence, now: Fitted):
    """One pass: effects that the others have made needless are taken out again."""
    kept = list(range(len(now.state.chosen)))
    for i in reversed(range(len(now.state.chosen))):
        if len(kept) < 2:
            break
        fewer = evidence.refitted(now.state.without(kept.index(i)))
        if not surely_positive(fewer.squares - now.squares):
            now = fewer
            kept.remove(i)
    return now, kept
