"""What a page looks like to an installed Chromium: overflow, what it asks for, what it complains of."""

import re
import shutil
import subprocess
from html import escape

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
# no network, no first-start traffic; as root in a container Chromium has no sandbox of its own
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--enable-logging=stderr",
)
FRAME = '<iframe style="border:0;height:3000px;width:%dpx;color-scheme:%s" data-scheme="%s" srcdoc="%s"></iframe>'
PROBE = """<!DOCTYPE html><meta charset="utf-8"><body style="margin:0">%s<pre id="out">waiting</pre><script>
const out = [];
function light(colour) {
  const parts = colour.match(/[0-9.]+/g).slice(0, 3).map((c) => c / 255);
  const linear = parts.map((c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}
function look(frame) {
  const inner = frame.contentDocument, width = frame.clientWidth, name = width + " " + frame.dataset.scheme + ": ";
  if (inner.documentElement.scrollWidth > width) out.push(name + "page " + inner.documentElement.scrollWidth);
  for (const element of inner.querySelectorAll("body *")) {
    if (element.closest(".scroll table") || element.closest("svg") && element.tagName !== "svg") continue;
    const box = element.getBoundingClientRect();
    const outside = box.right > width + 0.5 || box.left < -0.5;
    if (outside) out.push(name + element.className + " " + box.left + " " + box.right);
  }
  const drawn = [...inner.querySelectorAll(".drawing svg")].map((svg) => svg.getBoundingClientRect());
  const small = drawn.some((box) => box.width < 200 || box.height < 100);
  if (!drawn.length || small) out.push(name + "a chart is too small");
  for (const wide of inner.querySelectorAll(".scroll:has(.runs, .datasheet, .map)")) {
    const beyond = width >= 1400 && wide.scrollWidth > wide.clientWidth;
    if (beyond) out.push(name + "a table needs scrolling: " + wide.firstElementChild.className);
  }
  for (const ticks of inner.querySelectorAll(".x")) {
    const boxes = [...ticks.children].map((span) => span.getBoundingClientRect());
    boxes.slice(1).forEach((box, k) => { if (box.left < boxes[k].right) out.push(name + "ticks touch"); });
  }
  const style = frame.contentWindow.getComputedStyle(inner.body);
  const both = [light(style.color), light(style.backgroundColor)].sort((a, b) => b - a);
  if ((both[0] + 0.05) / (both[1] + 0.05) < 7) out.push(name + "text on its ground is hard to read");
  const dark = light(style.backgroundColor) < 0.5;
  if (dark !== (frame.dataset.scheme === "dark")) out.push(name + "the ground is that of the other scheme");
  const asked = frame.contentWindow.performance.getEntriesByType("resource");
  if (asked.length) out.push(name + "asked for " + asked[0].name);
  return [...inner.querySelectorAll("*")].map((element) => element.tagName.toLowerCase()).join(" ");
}
addEventListener("load", () => {
  const tags = [...document.querySelectorAll("iframe")].map(look);
  document.getElementById("out").textContent = (out.join("; ") || "fits") + "|" + tags[0];
});
</script>"""


def look(tmp_path, page, widths, schemes):
    """Faults, or `fits`; the tags as the browser read them; and what it wrote to its console."""
    frames = "".join(FRAME % (width, item, item, escape(page, quote=True)) for width in widths for item in schemes)
    text, console = dumped(tmp_path, PROBE % frames, max(widths) + 100)
    said, _, tags = text.partition("|")
    return said, tags.split(), console


def dumped(tmp_path, probe, width):
    """What a probe page wrote into its element `out`, and what it wrote to its console."""
    (tmp_path / "probe.html").write_text(probe, encoding="utf-8")
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},3000"]
    done = subprocess.run(
        [*command, "--virtual-time-budget=2000", "--dump-dom", (tmp_path / "probe.html").as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    text = re.search('<pre id="out">(.*?)</pre>', done.stdout, re.DOTALL)[1]
    return text, [line for line in done.stderr.splitlines() if "CONSOLE" in line]
