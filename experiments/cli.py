"""The `ssac` command is a table of commands, each of which is imported only when it is called.

Progress goes to stderr, results to stdout; the exit codes are those of `ssac.cli.exits`.
"""

from ssac.cli.command_line import COMPARE, IMPORT, SYNC, TRACK, USE, Entry, command_line

REPRODUCE = "Reproduce"

COMMANDS = (
    Entry("simulate", USE, "Simulate event cameras that watch a drone, with ground truth.",
          "experiments.scenes.simulate", "simulate_command"),
    SYNC,
    Entry("demo", USE, "Simulate 20 s, recover offset and pose, write a report.",
          "experiments.scenes.demo", "demo_command"),
    TRACK,
    IMPORT,
    COMPARE,
    Entry("tables", REPRODUCE, "The paper's simulation tables, all methods.",
          "experiments.studies.tables", "command"),
    Entry("study", REPRODUCE, "Studies beyond the tables: all runs, summary, figure.",
          "experiments.commands", "study_command"),
    Entry("ablate", REPRODUCE, "Ablations: one parameter varied at a time.",
          "experiments.commands", "ablate_command"),
    Entry("sweep", REPRODUCE, "Any grid of parameters, one CSV row per run.",
          "experiments.commands", "sweep_command"),
    Entry("merge", REPRODUCE, "Join the shards of a sweep or study.",
          "experiments.commands", "merge_command"),
    Entry("scene", REPRODUCE, "Statistics of the default scene, beside the authors' sample.",
          "experiments.scenes.scene", "scene_command"),
    Entry("figures", REPRODUCE, "Draw the paper's figures, and those of all studies anew.",
          "experiments.studies.figures", "figures_command"),
    Entry("report", REPRODUCE, "All results on one HTML page.",
          "experiments.report.report", "report_command"),
    Entry("numbers", REPRODUCE, "Update the numbers quoted in README and docs.",
          "experiments.commands", "numbers_command"),
    Entry("real", REPRODUCE, "Public drone-tracking data sets (download them first).",
          "experiments.studies.real", "real_command"),
    Entry("outdoor", REPRODUCE, "The paper's outdoor experiment, simulated.",
          "experiments.studies.outdoor", "command"),
    Entry("network", REPRODUCE, "Many cameras at once: errors of four, run time with eight.",
          "experiments.studies.network", "command"),
    Entry("by-hand", REPRODUCE, "Ordinary and odd recordings: the default beside settings by hand.",
          "experiments.studies.by_hand", "command"),
    Entry("physical", REPRODUCE, "The paper's small-scale experiment, simulated; error budget.",
          "experiments.studies.physical", "command"),
    Entry("bench", REPRODUCE, "Speed and memory, beside the reference tools.",
          "experiments.studies.bench", "command"),
    Entry("verify", REPRODUCE, "Check that results/ is complete and reproducible.",
          "experiments.commands", "verify_command"),
)  # fmt: skip

app = command_line(
    COMMANDS,
    "Synchronise and calibrate two or more cameras from one moving object; simulate such "
    "recordings; reproduce the paper's tables and further studies.",
)
