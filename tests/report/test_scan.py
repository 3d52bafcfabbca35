"""Names of scanned devices in a bench file."""

from leactl.bench.benchfile import CanBus
from leactl.bench.scan import Answered, WireReport
from leactl.driver.contract import Identity
from leactl.driver.probe import Sighting
from leactl.report import scan
from leactl.runner.scan import ScannedWire


def test_only_devices_of_one_driver_and_one_address_get_a_letter():
    bus = CanBus(kind="can", interface="virtual", channel="a")
    wire = ScannedWire("can0", "can0", (bus,))
    report = WireReport("can0")
    report.answered += [Answered("elmo_can", Sighting(address, Identity(), {})) for address in (10, 1, 1, 11)]
    names = [device["name"] for device in scan.as_json([(wire, report)])["devices"]]
    assert names == ["elmo_can_10", "elmo_can_1", "elmo_can_1_b", "elmo_can_11"]
