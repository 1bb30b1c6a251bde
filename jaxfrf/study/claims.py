"""What the paper concludes, and whether R3X confirms it."""

import equinox as eqx

from .settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS


class Claim(eqx.Module):
    """`says`: the paper's statement. `paper`, `found`: its figures and the study's. `confirmed`: whether the order is
    the paper's; `None` where the study has not the data."""

    says: str
    paper: str
    found: str
    confirmed: bool | None

    def as_dict(self) -> dict:
        return {"says": self.says, "paper": self.paper, "found": self.found, "confirmed": self.confirmed}


def claims(results: dict) -> list[Claim]:
    """Every conclusion of the paper beside the tables of a study."""
    bias = {
        int(count): {method: entry["mean"] for method, entry in by.items()}
        for count, by in results["bias"]["bias"]["in motion"].items()
    }
    by = {(row["experiments"], row["method"]): row["mean_bias"]["median"] for row in results["summary"]}
    most = max(bias)
    published = PUBLISHED_BIAS[24]
    number = lambda x: f"{x:.1f}"
    percent = lambda x: f"{100 * x:.1f} %"
    found = [
        Claim(
            "A MIMO parametrisation in LRM is more accurate than MISO where n_e > 1",
            f"n_e = 24: {published['LRM, MIMO']} against {published['LRM, MISO']}",
            f"n_e = {most}: {number(bias[most]['LRM, MIMO'])} against {number(bias[most]['LRM, MISO'])}",
            bias[most]["LRM, MIMO"] < bias[most]["LRM, MISO"],
        ),
        Claim(
            "The joint input-output approach reduces the bias of LRM a lot",
            f"n_e = 6: {PUBLISHED_BIAS[6]['LRM, JIO']} against {PUBLISHED_BIAS[6]['LRM, MIMO']}",
            f"n_e = 6: {number(bias[6]['LRM, JIO'])} against {number(bias[6]['LRM, MIMO'])}",
            bias[6]["LRM, JIO"] < 0.9 * bias[6]["LRM, MIMO"],
        ),
        Claim(
            "Without a local model JIO improves little on LOG",
            f"n_e = 24: {published['JIO']} against {published['LOG']}",
            f"n_e = {most}: {number(bias[most]['JIO'])} against {number(bias[most]['LOG'])}",
            0.85 < bias[most]["JIO"] / bias[most]["LOG"] < 1.05,
        ),
        Claim(
            "JIO-LRM with logarithmic averaging is the most accurate of the paper's methods at the same time",
            f"n_e = 24: {published['LRM, JIO']}, next {published['JIO']}; n_e = 6: {PUBLISHED_BIAS[6]['LRM, JIO']}",
            "; ".join(
                f"n_e = {c}: {number(bias[c]['LRM, JIO'])}, next "
                f"{number(min(v for m, v in bias[c].items() if m in published and m != 'LRM, JIO'))}"
                for c in (most, 6)
            ),
            all(bias[c]["LRM, JIO"] == min(bias[c][m] for m in published) for c in (most, 6)),
        ),
        Claim(
            "JIO-LRM from one experiment has a lower FRF bias than LOG from six",
            f"{PUBLISHED_BIAS[1]['LRM, JIO']} against {PUBLISHED_BIAS[6]['LOG']}",
            f"{number(bias[1]['LRM, JIO'])} against {number(bias[6]['LOG'])}",
            bias[1]["LRM, JIO"] < bias[6]["LOG"],
        ),
        Claim(
            "More experiments improve the FRF (JIO-LRM)",
            f"{PUBLISHED_BIAS[1]['LRM, JIO']}, {PUBLISHED_BIAS[6]['LRM, JIO']}, {published['LRM, JIO']}",
            ", ".join(f"n_e = {c}: {number(bias[c]['LRM, JIO'])}" for c in (1, 6, most)),
            bias[most]["LRM, JIO"] < bias[6]["LRM, JIO"] < bias[1]["LRM, JIO"],
        ),
    ]
    return found + _parameter_claims(by, most, percent)


def _parameter_claims(by, most: int, percent) -> list[Claim]:
    paper = PUBLISHED_PARAMETERS
    pairs = [(c, by.get((c, "LRM, JIO")), by.get((c, "LOG"))) for c in (6, most)]
    return [
        Claim(
            "JIO-LRM gives better parameters than LOG from the same experiments",
            "; ".join(
                f"n_e = {c}: {percent(paper[c]['LRM, JIO'])} against {percent(paper[c]['LOG'])}" for c in (6, 24)
            ),
            "; ".join(f"n_e = {c}: {percent(a)} against {percent(b)}" for c, a, b in pairs),
            all(a < b for _, a, b in pairs),
        ),
        Claim(
            "Parameters from LOG with six experiments are better than from JIO-LRM with one",
            f"{percent(paper[6]['LOG'])} against {percent(paper[1]['LRM, JIO'])}",
            f"{percent(by[6, 'LOG'])} against {percent(by[1, 'LRM, JIO'])}",
            by[6, "LOG"] < by[1, "LRM, JIO"],
        ),
        Claim(
            "One experiment gives only poor parameters",
            f"{percent(paper[1]['LRM, JIO'])}",
            f"direct {percent(by[1, 'LRM, JIO'])}; through the experiment "
            + (percent(by[1, "through the experiment"]) if (1, "through the experiment") in by else "not made"),
            by.get((1, "through the experiment"), by[1, "LRM, JIO"]) > 0.05,
        ),
    ]
