"""What the page of a run costs: CPU time of its server and of the thread that feeds it, one page being open."""

import http.client
import time
from pathlib import Path
from urllib.parse import urlsplit

from leactl.quantities import ChannelSpec
from leactl.report.web.feed import RunPage
from leactl.runner.progress import Progress

LASTS_S, EVERY_S = 30.0, 0.5
LIMIT = 0.05  # of a core
CHANNELS = tuple(ChannelSpec(f"torque_{number}", "torque", "test", "sensor") for number in range(20))


def cpu_s(process):
    return 1e-9 * int(Path(f"/proc/{process}/schedstat").read_text().split()[0])


def test_a_page_costs_little(capsys):
    progress = Progress("a run", LASTS_S, {"loop": CHANNELS}, [0.123456789] * len(CHANNELS))
    with RunPage("127.0.0.1:0", "bench") as page:
        page.show(progress)
        address = urlsplit(page.url)
        headers = {"Authorization": f"Bearer {page.url.partition('token=')[2]}"}

        def ask():
            connection = http.client.HTTPConnection(address.hostname, address.port)
            connection.request(
                "GET", "/state?since=0", headers=headers
            )  # more than a page asks for, which has most rows
            assert connection.getresponse().read()
            connection.close()

        ask()
        clock = time.pthread_getcpuclockid(page._thread.ident)
        server, feed, began = cpu_s(page._server.pid), time.clock_gettime(clock), time.monotonic()
        while (now := time.monotonic()) < began + LASTS_S:
            progress.time_s = now
            ask()
            time.sleep(EVERY_S)
        lasted = time.monotonic() - began
        shares = (cpu_s(page._server.pid) - server) / lasted, (time.clock_gettime(clock) - feed) / lasted
    with capsys.disabled():
        print(f"\npage of a run: server {shares[0]:.2%} of a core, feed {shares[1]:.2%}")
    assert sum(shares) < LIMIT
