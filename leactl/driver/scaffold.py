"""Write the skeleton of a package with one driver, in which two functions are left to fill in."""

import keyword
import re
import tempfile
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template

from leactl.driver import registry
from leactl.errors import InputError
from leactl.quantities import FLAGS, UNITS

TEST_VALUES = {"serial": "0.0, 1.25, -0.5, 40.0", "i2c": "0.0, 1.25, 40.0"}  # of the package's test, by bus
BUSES = tuple(TEST_VALUES)
NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def write_package(name: str, bus: str, quantity: str, into: Path) -> Path:
    """Write a package for a driver, whole or not at all; return its folder.

    Parameters
    ----------
    name : name of the driver in bench files.
    bus : one of `BUSES`.
    quantity : quantity that the device measures, one of the vocabulary.
    into : directory in which the folder `leactl-NAME` is created.

    Raises
    ------
    InputError : an invalid or used name, one whose class would hide another, an unknown bus or quantity, or a folder
        that exists.
    """
    if not NAME.fullmatch(name):
        raise InputError(f"'{name}': small letters, digits and single underscores were expected, a letter first")
    if name in registry.names():
        raise InputError(f"driver '{name}' is registered already; another name was expected")
    if bus not in BUSES:
        raise InputError(f"bus '{bus}' has no template; {' or '.join(BUSES)} was expected")
    if quantity not in UNITS:
        raise InputError(f"quantity '{quantity}' is not known; known: {', '.join(UNITS)}")
    words = name.split("_")
    dashed, class_name = "-".join(words), "".join(word.capitalize() for word in words)
    templates = resources.files("leactl.driver.templates") / bus
    if keyword.iskeyword(class_name) or class_name in _imported_names(templates):
        raise InputError(f"'{name}': its class would be {class_name}, which means something else there already")
    folder = into / f"leactl-{dashed}"
    if folder.exists():
        raise InputError(f"{folder} is there already; nothing was written")
    substitutions = {
        "name": name,
        "dashed": dashed,
        "class_name": class_name,
        "title": f"{' '.join(words)}, {quantity.replace('_', ' ')} over {'I2C' if bus == 'i2c' else 'a serial line'}",
        "quantity": quantity,
        "units": "0 or 1" if quantity in FLAGS else f"in {UNITS[quantity]}",
        "values": "0.0, 1.0" if quantity in FLAGS else TEST_VALUES[bus],
    }
    file_names = {"pyproject.toml": "pyproject.toml", "test_driver.py": f"tests/test_{name}.py"}
    try:
        with tempfile.TemporaryDirectory(prefix=".leactl-", dir=into) as temporary:
            package = Path(temporary) / folder.name
            for template in templates.iterdir():
                file_name = template.name.removesuffix(".txt")
                target = package / file_names.get(file_name, f"leactl_{name}/{file_name}")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(Template(template.read_text("utf-8")).substitute(substitutions), encoding="utf-8")
            package.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder


def _imported_names(templates: Traversable) -> set[str]:
    """Return the names that the driver's template imports; a class of such a name would replace the imported one."""
    text = (templates / "driver.py.txt").read_text("utf-8")
    lines = re.findall(r"^from \S+ import (.+)$", text, re.MULTILINE)
    return {name for line in lines for name in line.split(", ")}
