"""Pages of a stranger's run, whose every text holds a script, have the elements of those of a sound one and no more."""

from html.parser import HTMLParser
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

from leactl.runfile import layout
from tests.analysis.short_runs import short_run
from tests.cli.terminal import leactl
from tests.runfile.specimen import unseal

SCRIPT = "\"'></script></style></title><script>document.body.remove()</script><svg onload=alert(1)>&lt;b&gt;]]>"
OWN = ("protocol", "status", "created", "format", "software")  # root attributes without which no page is made
COMMANDS = {
    "runs plot": lambda run, page: ("runs", "plot", run, "--html", page),
    "report": lambda run, page: ("report", run, "--html", page),
}


def spoil(path):
    with h5py.File(path, "r+") as file:
        unseal(file)
        for _, dataset in list(layout.datasets(file)):
            del dataset.attrs["sha256"]
        for name in file.attrs:
            if name not in OWN and isinstance(file.attrs[name], str):
                file.attrs[name] = SCRIPT
        for group in file["streams"].values():
            for channel in group.values():
                for name in {"device", "long_name", "location"} & set(channel.attrs):
                    channel.attrs[name] = SCRIPT
        for device in file["instruments"].values():
            for name in layout.INSTRUMENT:
                device.attrs[name] = SCRIPT
        file.move("streams/torque_sensor", f"streams/{SCRIPT.replace('/', '')}")
        for place, text in (("events/message", SCRIPT), ("events/source", SCRIPT)):
            file[place][:] = [text] * len(file[place])
        names = layout.texts(file["steps/name"])
        file["steps/name"][:] = [name if name == "hold" else f"{name}{SCRIPT}" for name in names]
        model = file["model/source"][()].decode()
        del file["model/source"]
        file["model/source"] = model.replace("name: ", f"name: '{SCRIPT.replace(chr(39), chr(39) * 2)}' # ", 1)
        file["parameters"].attrs["remark"] = np.array([SCRIPT], layout.TEXT)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """By command: the page of the run as it was, and as a stranger made it."""
    folder = tmp_path_factory.mktemp("run")
    run = short_run("friction", folder)
    results = {}
    for title, arguments in COMMANDS.items():
        results[title] = [(folder / f"{title}.html".replace(" ", "-"))]
        assert leactl(*arguments(run, results[title][0])).returncode == 0
    assert leactl("runs", "annotate", run, SCRIPT, "--author", SCRIPT).returncode == 0
    spoil(run)
    for title, arguments in COMMANDS.items():
        page = folder / f"{title}-spoilt.html".replace(" ", "-")
        done = leactl(*arguments(run, page))
        assert done.returncode == 0, done.stderr
        results[title].append(page)
    return {title: [page.read_text(encoding="utf-8") for page in both] for title, both in results.items()}


def elements(page):
    return list(ElementTree.fromstring(page.split("\n", 1)[1]).iter())


@pytest.mark.parametrize("title", COMMANDS)
def test_no_text_of_a_run_becomes_an_element(pages, title):
    sound, spoilt = map(elements, pages[title])
    assert {element.tag for element in spoilt} <= {element.tag for element in sound}
    scripts = [[element.text for element in every if element.tag == "script"] for every in (sound, spoilt)]
    assert scripts[0] == scripts[1]
    assert not [name for element in spoilt for name in element.attrib if name.startswith("on")]
    assert any("document.body.remove()" in text for element in spoilt for text in element.itertext())


class Tags(HTMLParser):
    """The elements as a browser begins them, which reads scripts and titles otherwise than XML."""

    def __init__(self, page):
        super().__init__()
        self.seen = set()
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.seen |= {tag, *(f"{tag} {name}" for name, _ in attrs if name.startswith("on"))}


@pytest.mark.parametrize("title", COMMANDS)
def test_nor_where_a_browser_reads_it(pages, title):
    sound, spoilt = pages[title]
    assert Tags(spoilt).seen <= Tags(sound).seen
