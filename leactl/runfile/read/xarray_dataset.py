"""Convert a run to an xarray dataset with the names, units and times of the file."""

from typing import TYPE_CHECKING

from leactl.errors import InputError
from leactl.quantities import ChannelSpec

if TYPE_CHECKING:
    import xarray

    from leactl.runfile.read.reader import Run


def dataset(run: "Run") -> "xarray.Dataset":
    """Convert a run; see `Run.to_xarray`."""
    try:
        import xarray
    except ImportError:
        raise InputError("xarray is not installed; pip install 'leactl[xarray]'") from None
    coordinates = {stream: (stream, run.time(stream), {"units": "s"}) for stream in run.streams}
    variables = {}
    for stream, specs in run.streams.items():
        for spec in specs:
            name = _name(spec)
            name = f"{name}_{stream}" if name in variables else name
            variables[name] = (stream, run.values(stream, spec.name, 0, run.rows[stream]), _about(spec))
    attributes = {name: value for name, value in run.attributes.items() if isinstance(value, str | int | float)}
    return xarray.Dataset(variables, coordinates, attributes)


def _name(spec: ChannelSpec) -> str:
    """Return the variable's name: role, quantity and location of the channel."""
    return "_".join(filter(None, (spec.role, spec.quantity or spec.name, spec.location)))


def _about(spec: ChannelSpec) -> dict[str, object]:
    """Return the attributes of the variable, without empty ones and zeros."""
    attributes = {
        "units": spec.units,
        "long_name": spec.long_name,
        "quantity": spec.quantity,
        "role": spec.role,
        "location": spec.location,
        "device": spec.device,
        "sampling": spec.sampling,
        "skew_s": spec.skew_s,
        "scale_std": spec.scale_std,
    }
    return {name: value for name, value in attributes.items() if value not in ("", 0.0)}
