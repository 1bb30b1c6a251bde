"""What the paper concludes, and whether R3X confirms it."""

import itertools

import equinox as eqx

from .settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS


class Claim(eqx.Module):
    """`says`: the paper's statement. `paper`, `found`: its figures and the study's. `confirmed`: whether the order is
    the paper's."""

    says: str
    paper: str
    found: str
    confirmed: bool

    def as_dict(self) -> dict:
        return {"says": self.says, "paper": self.paper, "found": self.found, "confirmed": self.confirmed}


def claims(results: dict) -> list[Claim]:
    """The paper's conclusions beside the tables of a study, those that it has the data for."""
    bias = {
        (int(count), method): entry["mean"]
        for count, by in results["bias"]["bias"]["in motion"].items()
        for method, entry in by.items()
    }
    fits = {(row["experiments"], row["method"]): row["mean_bias"]["median"] for row in results["summary"]}
    most = max(count for count, _ in bias)
    made = []
    for claim in (*_FRF_CLAIMS, *_PARAMETER_CLAIMS):
        try:
            made.append(claim(bias if claim in _FRF_CLAIMS else fits, most))
        except KeyError:  # a method or number of experiments that this study leaves out
            continue
    return made


def _number(x: float) -> str:
    return f"{x:.1f}"


def _percent(x: float) -> str:
    return f"{100 * x:.1f} %"


def _mimo(bias, most: int) -> Claim:
    published = PUBLISHED_BIAS[24]
    return Claim(
        "A MIMO parametrisation in LRM is more accurate than MISO where n_e > 1",
        f"n_e = 24: {published['LRM, MIMO']} against {published['LRM, MISO']}",
        f"n_e = {most}: {_number(bias[most, 'LRM, MIMO'])} against {_number(bias[most, 'LRM, MISO'])}",
        bias[most, "LRM, MIMO"] < bias[most, "LRM, MISO"],
    )


def _jio(bias, most: int) -> Claim:
    return Claim(
        "The joint input-output approach reduces the bias of LRM a lot",
        f"n_e = 6: {PUBLISHED_BIAS[6]['LRM, JIO']} against {PUBLISHED_BIAS[6]['LRM, MIMO']}",
        f"n_e = 6: {_number(bias[6, 'LRM, JIO'])} against {_number(bias[6, 'LRM, MIMO'])}",
        bias[6, "LRM, JIO"] < 0.9 * bias[6, "LRM, MIMO"],
    )


def _jio_alone(bias, most: int) -> Claim:
    if most == 6:
        raise KeyError("more experiments than axes: with as many, JIO without a local model is LOG")
    published = PUBLISHED_BIAS[24]
    return Claim(
        "Without a local model JIO improves little on LOG",
        f"n_e = 24: {published['JIO']} against {published['LOG']}",
        f"n_e = {most}: {_number(bias[most, 'JIO'])} against {_number(bias[most, 'LOG'])}",
        0.85 < bias[most, "JIO"] / bias[most, "LOG"] < 1.05,
    )


def _best(bias, most: int) -> Claim:
    published = PUBLISHED_BIAS[24]
    counts = tuple(dict.fromkeys((most, 6)))
    return Claim(
        "JIO-LRM with logarithmic averaging is the most accurate of the paper's methods at the same time",
        f"n_e = 24: {published['LRM, JIO']}, next {published['JIO']}; n_e = 6: {PUBLISHED_BIAS[6]['LRM, JIO']}",
        "; ".join(
            f"n_e = {c}: {_number(bias[c, 'LRM, JIO'])}, next "
            f"{_number(min(bias[c, m] for m in published if m != 'LRM, JIO'))}"
            for c in counts
        ),
        all(bias[c, "LRM, JIO"] == min(bias[c, m] for m in published) for c in counts),
    )


def _one_against_six(bias, most: int) -> Claim:
    return Claim(
        "JIO-LRM from one experiment has a lower FRF bias than LOG from six",
        f"{PUBLISHED_BIAS[1]['LRM, JIO']} against {PUBLISHED_BIAS[6]['LOG']}",
        f"{_number(bias[1, 'LRM, JIO'])} against {_number(bias[6, 'LOG'])}",
        bias[1, "LRM, JIO"] < bias[6, "LOG"],
    )


def _more(bias, most: int) -> Claim:
    counts = tuple(dict.fromkeys((1, 6, most)))
    values = [bias[c, "LRM, JIO"] for c in counts]
    return Claim(
        "More experiments improve the FRF (JIO-LRM)",
        ", ".join(f"{PUBLISHED_BIAS[c]['LRM, JIO']}" for c in (1, 6, 24)),
        ", ".join(f"n_e = {c}: {_number(x)}" for c, x in zip(counts, values, strict=True)),
        all(later < sooner for sooner, later in itertools.pairwise(values)),
    )


def _jio_parameters(fits, most: int) -> Claim:
    counts = tuple(dict.fromkeys((6, most)))
    pairs = [(c, fits[c, "LRM, JIO"], fits[c, "LOG"]) for c in counts]
    paper = PUBLISHED_PARAMETERS
    return Claim(
        "JIO-LRM gives better parameters than LOG from the same experiments",
        "; ".join(f"n_e = {c}: {_percent(paper[c]['LRM, JIO'])} against {_percent(paper[c]['LOG'])}" for c in (6, 24)),
        "; ".join(f"n_e = {c}: {_percent(a)} against {_percent(b)}" for c, a, b in pairs),
        all(a < b for _, a, b in pairs),
    )


def _six_against_one(fits, most: int) -> Claim:
    paper = PUBLISHED_PARAMETERS
    return Claim(
        "Parameters from LOG with six experiments are better than from JIO-LRM with one",
        f"{_percent(paper[6]['LOG'])} against {_percent(paper[1]['LRM, JIO'])}",
        f"{_percent(fits[6, 'LOG'])} against {_percent(fits[1, 'LRM, JIO'])}",
        fits[6, "LOG"] < fits[1, "LRM, JIO"],
    )


def _poor(fits, most: int) -> Claim:
    direct, indirect = fits[1, "LRM, JIO"], fits.get((1, "indirect"))
    return Claim(
        "One experiment gives only poor parameters",
        f"{_percent(PUBLISHED_PARAMETERS[1]['LRM, JIO'])}",
        f"direct {_percent(direct)}; indirect {'not made' if indirect is None else _percent(indirect)}",
        (direct if indirect is None else indirect) > 0.05,
    )


_FRF_CLAIMS = (_mimo, _jio, _jio_alone, _best, _one_against_six, _more)
_PARAMETER_CLAIMS = (_jio_parameters, _six_against_one, _poor)
