"""What is wrong with a record, or suspicious: where it is, how much, how sure, and what it does to the FRF."""

from .finding import Finding as Finding, Severity as Severity
from .screen import (
    ACROSS as ACROSS,
    CHECKS as CHECKS,
    ScreenedPart as ScreenedPart,
    across_all as across_all,
    examine as examine,
    refused as refused,
    screen as screen,
    screen_part as screen_part,
    screened as screened,
    sentences as sentences,
)
