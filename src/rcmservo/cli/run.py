"""`rcmservo run`: a simulated run and its output folder.

The options are `RunOptions` in run_options.py; simulated_run/ does the run.
"""

from rcmservo.cli.new_target_file import require_new_target_file
from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.progress.run_progress import RunProgress
from rcmservo.cli.result_output import print_result
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.terminal import open_console, open_status_line
from rcmservo.config.new_folder import open_new_folder
from rcmservo.errors import require_extra
from rcmservo.hardware.device_kinds import prepare_tracker


def run(options: RunOptions) -> int:
    """Run, write the folder and print the result; return 0 if the run settled."""
    with require_extra("run", "sim"):
        from rcmservo.sim.disturbances import describe_kinds
    if "help" in options.disturb:
        print(describe_kinds())
        return 0
    require_new_target_file(options.target, options.save_target)
    # these properties raise an error for invalid options before anything is written
    _ = options.servo, options.rig_settings, options.disturbances
    prepare_tracker(options.lab)
    console = open_console(stderr=options.json)
    with open_new_folder(options.out, f"run-seed{options.seed}") as folder:
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        console.print(words, style="dim", soft_wrap=True)
        with open_status_line(console) as line, report_compilation(line) as count_kernel:
            from rcmservo.cli.simulated_run.simulate import simulate

            result = simulate(options, folder, RunProgress(line, options.duration), count_kernel)
    return print_result(console, result, options.json)
