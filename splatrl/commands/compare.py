"""``splatrl-compare``: a report on trainings that are finished, such as those of a sweep."""

import argparse

from splatrl.commands.entries import compare as main
from splatrl.commands.faults import in_one_line
from splatrl.documents import read_json
from splatrl.experiments import compared, report_all, run_folders
from splatrl.experiments.results import entries
from splatrl.experiments.tables import main_table, verdicts
from splatrl.files import require_room

REPORT = "report.json"


@in_one_line("splatrl-compare")
def run(options: argparse.Namespace) -> None:
    """Report the trainings in run folders.

    Raises:
        ValueError: if the folder of the report holds other files.
    """
    out = options.out or options.runs[0] / "comparison"
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        known = read_json(out / REPORT) if (out / REPORT).is_file() else None
        if not isinstance(known, dict) or known.get("experiment") != "comparison":
            raise ValueError(
                f"{out}: expected a new folder, or that of an earlier comparison, got one with other files"
            )
    experiment = compared(run_folders(options.runs), out)
    out.mkdir(parents=True, exist_ok=True)
    require_room(out)
    (report,) = report_all([experiment], out, "")
    found = entries(experiment)
    print("\n".join([*experiment.left_out, *main_table(found), *verdicts(found), f"report: {report}"]))


if __name__ == "__main__":
    main()
