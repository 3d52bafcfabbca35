"""A package with one driver, to begin with: files of a folder, two functions of which are left to fill in."""

import re
import tempfile
from importlib import resources
from pathlib import Path
from string import Template

from leactl.driver import registry
from leactl.errors import InputError
from leactl.quantities import UNITS

BUSES = ("serial", "i2c")
NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def write_package(name: str, bus: str, quantity: str, into: Path) -> Path:
    """Write a package for a driver of this name, all of it or nothing; gives its folder.

    Parameters
    ----------
    name : of the driver, as a bench file will have it.
    bus : one of `BUSES`.
    quantity : what the device measures, one of the vocabulary.
    into : where the folder `leactl-NAME` is made.

    Raises
    ------
    InputError : a name that is none or is taken, an unknown bus or quantity, or a folder that is there already.
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
    dashed = "-".join(words)
    folder = into / f"leactl-{dashed}"
    if folder.exists():
        raise InputError(f"{folder} is there already; nothing was written")
    own_words = {
        "name": name,
        "dashed": dashed,
        "class_name": "".join(word.capitalize() for word in words),
        "title": f"{' '.join(words)}, {quantity.replace('_', ' ')} over {'I2C' if bus == 'i2c' else 'a serial line'}",
        "quantity": quantity,
        "units": UNITS[quantity],
    }
    places = {"pyproject.toml": "pyproject.toml", "test_driver.py": f"tests/test_{name}.py"}
    texts = resources.files("leactl.driver.templates") / bus
    try:
        with tempfile.TemporaryDirectory(prefix=".leactl-", dir=into) as begun:
            whole = Path(begun) / folder.name
            for text in texts.iterdir():
                file = text.name.removesuffix(".txt")
                place = whole / places.get(file, f"leactl_{name}/{file}")
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_text(Template(text.read_text("utf-8")).substitute(own_words), encoding="utf-8")
            whole.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder
