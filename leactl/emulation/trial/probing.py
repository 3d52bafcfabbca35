"""Requirements on the probe of a driver: it recognises its device, switches nothing on, and ends on a silent wire."""

from leactl.emulation.trial.known_bench import KnownMachine
from leactl.emulation.trial.stand import ROLE, Broken, Stand


def its_probe_recognises_its_device(stand: Stand) -> None:
    """The probe recognises one device, with the settings that the device has."""
    report = stand.scan()
    if report.notes:
        raise Broken(f"a scan of its emulator says: {report.notes[0]}")
    if len(report.answered) != 1:
        raise Broken(f"a scan of its emulator saw {len(report.answered)} devices; 1 was expected")
    sighting, expected_settings = report.answered[0].sighting, stand.settings
    if sighting.settings is None:
        raise Broken(f"a scan of its emulator says that it is for another driver: {sighting.detail}")
    if sighting.address != expected_settings.bus_address:
        raise Broken(f"a scan saw it at address {sighting.address}; {expected_settings.bus_address} was expected")
    for name, value in sighting.settings.items():
        if name not in type(expected_settings).model_fields:
            raise Broken(f"a scan gives it a setting '{name}', which its Settings lack")
        if getattr(expected_settings, name) != value:
            raise Broken(f"a scan gives it {name} {value!r}; {getattr(expected_settings, name)!r} was expected")


def its_probe_moves_and_energises_nothing(stand: Stand) -> None:
    """The machine stays off, and a supply gives no output, during a scan and after it."""
    stand.scan()
    stand.wait(1.0)
    machine, output = stand.bench.machines.get(ROLE, KnownMachine()), stand.bench.load.fed
    if machine.following[0] != "off" or any(output):
        raise Broken(f"after a scan the machine follows {machine.following} and {output[0]:g} V are put out")


def its_probe_ends_on_a_silent_wire(stand: Stand) -> None:
    """The probe recognises nothing if nothing answers, and ends by itself."""
    stand.cut()
    report = stand.scan()
    if report.answered:
        raise Broken("a scan of a silent wire saw a device")
    if notes_of_breaks := [note for note in report.notes if "was ended" in note or "breaks" in note]:
        raise Broken(f"a scan of a silent wire says: {notes_of_breaks[0]}")


TRIALS = (
    its_probe_recognises_its_device,
    its_probe_moves_and_energises_nothing,
    its_probe_ends_on_a_silent_wire,
)
