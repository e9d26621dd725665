"""Makes corpus/creatures.jsonl.zst and its gallery anew: short runs of evolution, and the best of each.

The runs are `nmes evolve` commands, one after another, each as given in `RUNS`; one that is in the folder already is
not run again. All of it gives the same bytes wherever the numbers are the same.

    .venv/bin/python tools/corpus.py runs/ [--jobs N]

With --gallery alone the gallery is drawn from the corpus that is there.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

__all__ = ["CORPUS", "GALLERY", "RUNS", "write_gallery"]

ROOT = Path(__file__).parent.parent
CORPUS = ROOT / "corpus" / "creatures.jsonl.zst"
GALLERY = ROOT / "docs" / "gallery.html"
BEST = 120
"""So many creatures of a run at most."""
_NMES = (sys.executable, "-P", "-m", "nmes")
_ELITES = (
    *("--algorithm", "map-elites"),
    *("--measure", "mass from 0 to 60 in 12", "--measure", "legs from 0 to 8 in 8"),
)
_SHORT = (*_ELITES, "--budget", "300", "--set", "initial=100")
_LONG = (*_ELITES, "--budget", "500")
_GENETIC = ("--algorithm", "ga", "--budget", "512")
_WALKERS = "walker galloper biped centipede inchworm prowler rambler roller lurcher tumbler sidewinder seeker"
_PLAN = (
    ("walk", _WALKERS, _LONG),
    ("walk", "random", _LONG),
    ("jump-far", "leaper jumper galloper", _LONG),
    ("jump-high", "jumper leaper galloper", _LONG),
    ("jump-high", "random", _LONG),
    ("swim", "eel sidewinder inchworm", _LONG),
    ("swim", "random", _LONG),
    ("rough", "walker galloper prowler rambler roller centipede", _LONG),
    ("rough", "random", _LONG),
    ("stairs", "climber walker galloper prowler rambler", _SHORT),
    ("reach", "seeker walker galloper", _LONG),
    ("pole", "random", _SHORT),
    ("planar-walk", "roller", _LONG),
    ("planar-walk", "random", _LONG),
    ("gaps", "walker galloper prowler leaper jumper roller", _SHORT),
    ("pole", "random", _GENETIC),
)
RUNS: dict[str, tuple[str, ...]] = {
    f"{number:02d}-{task}": (*starts.split(), "--task", task, "--seed", "1", "--seeds", "1-3", *how)
    for number, (task, starts, how) in enumerate(_PLAN)
}
"""The words of each run's command after `nmes evolve`, by the run's name."""


def write_gallery() -> None:
    """Draws the gallery from the corpus."""
    subprocess.run([*_NMES, "corpus", "page", str(CORPUS), "-o", str(GALLERY), "-q"], check=True)


def main() -> None:
    """Makes both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="where the runs are kept")
    parser.add_argument("--jobs", default="1", help="processes at once")
    parser.add_argument("--gallery", action="store_true", help="draw the gallery alone")
    options = parser.parse_args()
    if options.gallery:
        write_gallery()
        return
    if options.folder is None:
        parser.error("where are the runs to be kept?")
    for name, words in RUNS.items():
        if not (options.folder / name / "run.json").exists():
            print(name, flush=True)
            target = str(options.folder / name)
            subprocess.run([*_NMES, "evolve", *words, "--jobs", options.jobs, "-q", "-o", target], check=True)
    CORPUS.parent.mkdir(exist_ok=True)
    CORPUS.unlink(missing_ok=True)
    folders = [str(options.folder / name) for name in RUNS]
    subprocess.run(
        [*_NMES, "corpus", "add", str(CORPUS), *folders, "--best", str(BEST), "--jobs", options.jobs], check=True
    )
    write_gallery()


if __name__ == "__main__":
    main()
