"""Studies: claims, the runs that test them, and reports that follow from the results alone.

`docs/studies.md` says what a study is. Invariants: what is asked is written before it is run, and results name it by
its hash; a report is a pure function of study and results; of runs nothing is known but what `nmes` commands print.
"""

from nmes.study.document import Plan, Study
from nmes.study.report import write_report
from nmes.study.results import Results
from nmes.study.run import run_study
from nmes.study.verify import StudyVerdict, verify_study

__all__ = ["Plan", "Results", "Study", "StudyVerdict", "run_study", "verify_study", "write_report"]
