"""Temperatures of winding and housing: the two-node network driven by the measured heat.

The left-over is camera minus network. Parameters and effects act as heat on the network's nodes at the measured
temperatures; their columns are the network's response to that heat.
"""

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import Equation, Place
from leactl.gap.signals.record import Record
from leactl.model.thermal_network import ThermalNetwork

Array = npt.NDArray[np.float64]
START_PRIOR = 5.0  # K, prior error of a start: a winding that begins hot cools by kelvins within the smoothing


def temperatures(record: Record, s: Signals) -> list[Equation]:
    """Return one equation for the winding and one for the housing; none if a channel or the network is missing."""
    thermal, clock = s.model.thermal, record.slow
    if thermal is None or clock is None or s.winding is None or s.housing is None or s.ambient is None:
        return []
    heat = s.extra.get("heat")
    if heat is None:
        return []
    network = ThermalNetwork(thermal, s.interval)
    winding, housing, ambient = s.winding, s.housing, s.ambient
    # thermal resistances [K/W]
    winding_ambient, winding_housing = thermal.winding_ambient_resistance, thermal.winding_housing_resistance
    housing_ambient = thermal.housing_ambient_resistance
    zeros = np.zeros_like(heat)
    network_temperatures = network.temperatures(heat, ambient, (float(winding[0]), float(housing[0])))
    flows = (
        (winding - ambient) / winding_ambient,
        (winding - housing) / winding_housing,
        (housing - ambient) / housing_ambient,
    )
    to_ambient, to_housing, to_air = (means_after_samples(flow) for flow in flows)
    winding_rate, housing_rate = (np.diff(node, append=node[-1]) / s.interval for node in (winding, housing))
    columns = {
        "thermal.winding_ambient_resistance": network.answer(to_ambient, zeros),
        "thermal.winding_housing_resistance": network.answer(to_housing, -to_housing),
        "thermal.housing_ambient_resistance": network.answer(zeros, to_air),
        "thermal.winding_capacitance": network.answer(-thermal.winding_capacitance * winding_rate, zeros),
        "thermal.housing_capacitance": network.answer(zeros, -thermal.housing_capacitance * housing_rate),
        "ambient_offset": network.answer(zeros + 1 / winding_ambient, zeros + 1 / housing_ambient),
    }
    start_columns = {
        "winding_start": network.answer(zeros, zeros, (1.0, 0.0)),
        "housing_start": network.answer(zeros, zeros, (0.0, 1.0)),
    }
    if record.mechanical != "heated":
        columns["phase_resistance"] = network.answer(heat, zeros)
    # rises by the same network as the columns: a camera that reads a fraction of the rises only scales the network
    winding_heat = thermal.winding_capacitance * winding_rate + to_ambient + to_housing
    housing_heat = thermal.housing_capacitance * housing_rate + to_air - to_housing
    rises = network.answer(winding_heat, housing_heat, (float(winding[0] - ambient[0]), float(housing[0] - ambient[0])))
    equations_of_nodes = []
    for node, name in enumerate(("winding", "housing")):
        key = (f"{name}_temperature", "test")
        equations_of_nodes.append(
            Equation(
                name,
                key[0],
                "test",
                "degC",
                clock.values[key] - network_temperatures[node],
                s,
                clock.all_valid(key, ("ambient_temperature", "bench")),
                _places(network, node, rises[node]),
                {name: column[node] for name, column in columns.items()},
                {name: (column[node], START_PRIOR) for name, column in start_columns.items()},
                width=0.0,
                step=1,
            )
        )
    return equations_of_nodes


def means_after_samples(values: Array) -> Array:
    """Return means over the interval that begins at each sample, in which the network holds its heat."""
    return np.concatenate([0.5 * (values[1:] + values[:-1]), values[-1:]])


def _places(network: ThermalNetwork, node: int, rise: Array) -> dict[str, Place]:
    """Return the places of effects in the equation of a node.

    rise : temperature of the node above ambient [K].
    """
    zeros = np.zeros_like(rise)
    return {
        "winding_heat": lambda c: np.asarray(network.answer(c, zeros)[node], np.float64),
        "housing_heat": lambda c: np.asarray(network.answer(zeros, c)[node], np.float64),
        "camera_rise": lambda c: c * rise,
    }
