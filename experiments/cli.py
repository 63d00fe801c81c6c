"""The `ssac` command: parse, call, print; nothing else.

Progress goes to stderr, results to stdout. Exit code 0: done; 1: no reliable estimate; 2: bad usage
or input that cannot be used, with one line that says why.
"""

import sys

import typer

from experiments.bench.bench import bench_command
from experiments.figures.figures import figures_command
from experiments.paper.tables import tables_command
from experiments.paper.verify import verify_command
from experiments.report.report import report_command
from experiments.scenes.demo import demo_command
from experiments.scenes.fidelity import fidelity_command
from experiments.scenes.scene import scene_command
from experiments.scenes.simulate import simulate_command
from experiments.studies.ablate import ablate_command
from experiments.studies.coverage import coverage_command
from experiments.studies.efficiency import efficiency_command
from experiments.studies.refusal import refusal_command
from experiments.studies.sweep import merge_command, sweep_command
from experiments.studies.tangency import tangency_study_command
from experiments.studies.zncc import zncc_study_command
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.tool.sync import BAD_INPUT, sync_command

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Synchronise and calibrate two event cameras from one moving object.",
)
app.command("simulate")(simulate_command)
app.command("sync")(sync_command)
app.command("tables")(tables_command)
app.command("ablate")(ablate_command)
app.command("figures")(figures_command)
app.command("report")(report_command)
app.command("verify")(verify_command)
app.command("efficiency")(efficiency_command)
app.command("sweep")(sweep_command)
app.command("merge")(merge_command)
app.command("demo")(demo_command)
app.command("scene")(scene_command)
app.command("fidelity")(fidelity_command)
app.command("zncc-study")(zncc_study_command)
app.command("tangency-study")(tangency_study_command)
app.command("refusal")(refusal_command)
app.command("coverage")(coverage_command)
app.command("bench")(bench_command)


def main() -> None:
    """Run the command line; what the user got wrong is one line, anything else is our bug."""
    try:
        app()
    except (SimError, SsacError) as error:
        typer.echo(f"error: {' '.join(str(error).split())}", err=True)
        sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()
