"""Would it be found again? Each effect looked for among what the same search finds in parts of the recording."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from string import digits

import numpy as np

from mbcacq.diagnosis.effect_found import NOT_SIZES, EffectFound, FoundAgain
from mbcacq.diagnosis.evidence.between_sets import BY, ORDERS, alike, by_effect, difference, like, orders_matched
from mbcacq.diagnosis.model_fit import ModelFit, PartModel
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.validation.folds import RepeatedSearch
from mbcacq.effects.effect import ParameterEstimate, Parameters, label_of
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.over_time import NAME as MOMENT
from mbcacq.quantities import K

Repetitions = Mapping[str, FoundAgain]  # by ``name:where``
SAME_MOMENT = 0.05  # share of the poses within which two moments may be one: parts have not the same poses


def repetitions(full: ModelFit, again: RepeatedSearch) -> Repetitions:
    """Each effect of a fit, each location of its unmodelled ones, and each covariate there, in the parts of a repeated search."""
    if full.empty:
        return {}
    parts, own = again.models(lambda count: None), by_effect(full.model)
    poses = full.geometry_only.linear.obs.n_poses
    out = {}
    for label in dict.fromkeys(m.label for m in full.model.members):
        found = [part.stated[label] for part in parts if label in part.stated and same_moment(own[label], part.stated[label], poses)]
        values = {name.partition(BY)[0]: tuple(stated[name] for stated in found if name in stated) for name in own[label]}
        out[label] = FoundAgain(label.partition(":")[2], len(found), len(parts), again.of_halves, values)
    keys = dict.fromkeys((group.location, group.depends_on) for group in full.random)
    ratios = {key: relative_sizes(full.random, parts, key) for key in keys}
    spread = spread_of_kinds(ratios) if again.of_halves else dict.fromkeys(keys, 0.0)
    for key, sizes in ratios.items():
        out[group_label(*key)] = FoundAgain(key[0], int(np.sum(sizes > 0)), len(parts), again.of_halves, size_spread=spread[key])
    for at in dict.fromkeys(at for at, _ in keys):
        found_in, largest = sum(shows(part, at, own) for part in parts), max(spread[key] for key in keys if key[0] == at)
        out[label_of(UNKNOWN, (at,))] = FoundAgain(at, found_in, len(parts), again.of_halves, size_spread=largest)
    return out


def group_label(at: str, depends_on: str) -> str:
    """The label of the unmodelled effect of one covariate at a location."""
    return label_of(UNKNOWN, (f"{at}({depends_on})",))


def relative_sizes(whole: Sequence[RandomEffect], parts: Sequence[PartModel], key: tuple[str, str]) -> np.ndarray:
    """(n,) size of the group of a location and covariate in each part, relative to that in the whole; 0 where a part has none."""

    def size(groups: Sequence[RandomEffect]) -> float:
        return max((float(g.sigma.max()) for g in groups if (g.location, g.depends_on) == key), default=0.0)

    return np.array([size(part.random) for part in parts]) / size(whole)


def relative_spread(sizes: np.ndarray) -> float:
    """Relative standard deviation of a size, from its values (n,) in disjoint parts."""
    return float(jackknife(sizes[:, None])[0] / max(sizes.mean(), 1e-300))


def spread_of_kinds(sizes: Mapping[tuple[str, str], np.ndarray]) -> dict[tuple[str, str], float]:
    """The relative spread of each size, pooled over the groups of its kind (links by the angle before them, say): what halves put now to
    one link and now to the next is at none of them for certain.
    """
    kinds: dict[tuple[str, str], list[float]] = {}
    kind = {key: (key[0].rstrip(digits), key[1].rstrip(digits)) for key in sizes}
    for key, each in sizes.items():
        kinds.setdefault(kind[key], []).append(relative_spread(each))
    return {key: float(np.sqrt(np.mean(np.square(kinds[kind[key]])))) for key in sizes}


def shows(part: PartModel, at: str, reported: Container[str]) -> bool:
    """Whether a part has something unmodelled at a location, or what is not reported there (``name:where``): that is the same error under
    a name.
    """
    named = any(at in m.candidate.where and m.label not in reported for m in part.model.members)
    return named or any(group.location == at for group in part.random)


def same_moment(own: Parameters, other: Parameters, poses: int) -> bool:
    """False for sudden changes at different moments: those are two events."""
    moments = [name for name in own if name.rpartition(".")[2] == MOMENT and name in other]
    for name in moments:
        (mine, my_std), (theirs, their_std) = (map(np.array, one[name].components) for one in (own, other))
        apart = np.abs(mine[:, None] - theirs).min(axis=1)
        if np.any(apart > np.maximum(K * np.hypot(my_std, np.max(their_std)), SAME_MOMENT * poses)):
            return False
    return True


def with_spread_between_parts(effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects with standard deviations that are no smaller than disjoint parts of the recording say (delete-a-group jackknife)."""
    return [replace(e, parameters=_spread(e)) if any(one.disjoint for one in e.found_again) else e for e in effects]


def _spread(effect: EffectFound) -> dict[str, ParameterEstimate]:
    out, spreads = dict(effect.parameters), dict[str, np.ndarray]()
    for one in effect.found_again:
        here = {name: effect.parameters[name] for name in one.values if name in effect.parameters}
        count = min((len(each) for each in one.values.values()), default=0)
        if count < 2 or not one.disjoint:
            continue
        parts = [orders_matched({name: one.values[name][k] for name in here}, here) for k in range(count)]
        for name, stated in here.items():
            if all(alike(part[name], stated) for part in parts):
                spreads[name] = jackknife(np.array([difference(name, part[name], stated) for part in parts]))
    pooled = pooled_ratio(out, spreads)
    for name, spread in spreads.items():
        values, stds = (np.array(x) for x in out[name].components)
        wider = stds if name.rpartition(".")[2] in NOT_SIZES else pooled * stds
        out[name] = like(out[name], values, np.where(np.isfinite(spread), np.maximum(wider, spread), stds))
    return out


def pooled_ratio(stated: Parameters, spreads: Mapping[str, np.ndarray]) -> float:
    """Difference between halves over the stated one, root mean square over all sizes of an effect; at least 1, since two values may agree
    by chance. Lines of a joint are pooled by ``output.orders``.
    """
    if any(name.endswith(ORDERS) for name in spreads):
        return 1.0
    ratios = [spread / np.array(stated[name].components[1]) for name, spread in spreads.items() if name.rpartition(".")[2] not in NOT_SIZES]
    each = np.concatenate([[], *ratios])
    known = each[np.isfinite(each)]
    return max(1.0, float(np.sqrt(np.mean(np.square(known))))) if len(known) else 1.0


def jackknife(values: np.ndarray) -> np.ndarray:
    """Standard deviation (k,) of what all of the data say, by what it is without each of n disjoint groups, values (n, k)."""
    n = len(values)
    return np.sqrt((n - 1) / n * np.sum((values - values.mean(axis=0)) ** 2, axis=0))
