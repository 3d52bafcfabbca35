"""Temperatures of winding and housing: the two-node network driven by the heat that went in.

The left-over is camera minus network; parameters and effects act as heat on the network's nodes, taken at the measured
temperatures, so that their columns are the network's answer to that heat.
"""

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import Equation, Place
from leactl.gap.signals.record import Record
from leactl.model.thermal_network import ThermalNetwork

Array = npt.NDArray[np.float64]
START_PRIOR = 5.0  # K: a winding that begins hot falls by kelvins within the smoothing


def temperatures(record: Record, s: Signals) -> list[Equation]:
    """One equation for the winding and one for the housing."""
    thermal, clock = s.model.thermal, record.slow
    if thermal is None or clock is None or s.winding is None or s.housing is None or s.ambient is None:
        return []
    heat = s.extra.get("heat")
    if heat is None:
        return []
    network = ThermalNetwork(thermal, s.interval)
    winding, housing, ambient = s.winding, s.housing, s.ambient
    wa, wh = thermal.winding_ambient_resistance, thermal.winding_housing_resistance
    ha = thermal.housing_ambient_resistance
    none = np.zeros_like(heat)
    driven = network.temperatures(heat, ambient, (float(winding[0]), float(housing[0])))
    flows = (winding - ambient) / wa, (winding - housing) / wh, (housing - ambient) / ha
    to_ambient, to_housing, away = (onwards(flow) for flow in flows)
    in_winding, in_housing = (np.diff(node, append=node[-1]) / s.interval for node in (winding, housing))
    columns = {
        "thermal.winding_ambient_resistance": network.answer(to_ambient, none),
        "thermal.winding_housing_resistance": network.answer(to_housing, -to_housing),
        "thermal.housing_ambient_resistance": network.answer(none, away),
        "thermal.winding_capacitance": network.answer(-thermal.winding_capacitance * in_winding, none),
        "thermal.housing_capacitance": network.answer(none, -thermal.housing_capacitance * in_housing),
        "ambient_offset": network.answer(none + 1 / wa, none + 1 / ha),
    }
    begun = {
        "winding_start": network.answer(none, none, (1.0, 0.0)),
        "housing_start": network.answer(none, none, (0.0, 1.0)),
    }
    if record.mechanical != "heated":
        columns["phase_resistance"] = network.answer(heat, none)
    # the rises as the columns have them: a camera that reads a fraction of them scales the network, and no more
    heated = thermal.winding_capacitance * in_winding + to_ambient + to_housing
    warmed = thermal.housing_capacitance * in_housing + away - to_housing
    rises = network.answer(heated, warmed, (float(winding[0] - ambient[0]), float(housing[0] - ambient[0])))
    balances = []
    for node, name in enumerate(("winding", "housing")):
        key = (f"{name}_temperature", "test")
        balances.append(
            Equation(
                name,
                key[0],
                "test",
                "degC",
                clock.values[key] - driven[node],
                s,
                clock.all_valid(key, ("ambient_temperature", "bench")),
                _places(network, node, rises[node]),
                {name: column[node] for name, column in columns.items()},
                {name: (column[node], START_PRIOR) for name, column in begun.items()},
                width=0.0,
                step=1,
            )
        )
    return balances


def onwards(values: Array) -> Array:
    """Means over the interval that begins at each sample, over which the network holds its heat."""
    return np.concatenate([0.5 * (values[1:] + values[:-1]), values[-1:]])


def _places(network: ThermalNetwork, node: int, rise: Array) -> dict[str, Place]:
    none = np.zeros_like(rise)
    return {
        "winding_heat": lambda c: np.asarray(network.answer(c, none)[node], np.float64),
        "housing_heat": lambda c: np.asarray(network.answer(none, c)[node], np.float64),
        "camera_rise": lambda c: c * rise,
    }
