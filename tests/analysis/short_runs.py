"""Every shipped experiment in a short form, run on the bench it is for by the command that a user runs."""

from tests.cli.terminal import leactl

MAP = ("rest_s=60", "speeds_rad_s=[2.62, 10.47, 7.85, 5.24]", "currents_A=[-12.0, -1.2, -9.6, -4.8]")
SETTINGS = {
    "friction": ("hold_s=2", "settle_s=1", "trials=2"),
    "no-load-loss": ("hold_s=1", "settle_s=0.5", "trials=1"),
    "coast-down": ("trials=2",),
    "torque-constant": ("trials=1", "rest_s=10"),
    "current-step": ("trials=1",),
    "current-noise": ("trials=1", "subtrials=1"),
    "position-step": ("trials=1",),
    "position-noise": ("trials=1",),
    "back-emf": ("hold_s=1.5",),
    "back-drive": ("trials=1",),
    "torque-pulses": ("trials=1",),
    "torque-sensor-calibration": ("hold_s=6", "repeats=2"),
    "torque-speed-envelope": ("trials=1",),
    "winding-rise": ("heating_s=1200",),
    "thermal": ("heating_s=1500", "cooling_s=1500"),
    "efficiency": MAP,
    "efficiency-driven": MAP,
    "breakaway": (),
}
HEATED = ("winding-rise", "thermal")


def short_run(experiment, folder):
    """Run an experiment into a folder and return the run file."""
    bench = "emulated-heated" if experiment in HEATED else "emulated"
    settings = [part for setting in SETTINGS[experiment] for part in ("--set", setting)]
    done = leactl("run", experiment, "--bench", bench, "--condition", "design", "--out", folder, *settings)
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("*.h5")
    return path
