"""The book's tables of keys hold every key that is read, and its formats the fields that are written."""

import pytest
from book_tables import told

from jaxfrf.io import designs
from jaxfrf.robot import schema
from jaxfrf.robot.tolerances import DEFAULTS, GROUPS


@pytest.mark.parametrize(
    ("after", "known"),
    [
        ("Joints stand", (*schema._ROBOT_KEYS, "urdf", "smoothing")),
        ("Of a `[[joint]]`", (*schema._LINK_KEYS, *schema._SPRING_KEYS, *schema._DRIVE_KEYS)),
        ("Of `[controller]`", schema._CONTROLLER_KEYS),
        ("Of `[tolerance]`", (*DEFAULTS, *GROUPS)),
    ],
)
def test_every_key_of_a_robot_has_a_row(after, known):
    assert set(known) <= told("keys.md", "Robots", after)


@pytest.mark.parametrize(
    ("after", "known"),
    [
        ("Of an experiment", designs._TOP),
        ("Of `[lines]`", designs._KEYS["[lines]"]),
        (
            "Of `[multisine]`",
            [k for t in ("[multisine]", "[multisine.spectrum]", "[slow_sine]") for k in designs._KEYS[t]],
        ),
    ],
)
def test_every_key_of_a_design_has_a_row(after, known):
    assert set(known) <= told("keys.md", "Designs", after)
