"""The paper reproduced: Zimmermann & Moberg's study on the reference robot R3X."""

from .run import run_study as run_study
from .settings import DEMO as DEMO, MEDIUM as MEDIUM, PAPER as PAPER, SCALES as SCALES, Settings as Settings
