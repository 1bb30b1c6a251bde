"""Pages for people: one HTML file each, with everything in it."""

from .calibration import calibration_page as calibration_page, write_calibration as write_calibration
from .gap import gap_page as gap_page, write_gap_report as write_gap_report
from .identification import identification_page as identification_page, write_identification as write_identification
from .page import (
    beside as beside,
    choice as choice,
    facts as facts,
    figure as figure,
    listing as listing,
    number as number,
    page as page,
    paragraph as paragraph,
    section as section,
    table as table,
    verdict as verdict,
    write_page as write_page,
)
from .response import frf_page as frf_page, write_frf_page as write_frf_page
