// Asks the server for the state of the run twice a second and shows it; axes.js has to be loaded before. When the
// server no longer answers, the page keeps the last values. Texts of the run are set as text, never as HTML.
const POLL_MS = 500, TIMEOUT_MS = 3000;
const MOST_FAILURES = 2; // failed requests in a row, from which the connection counts as lost
const SILENT_S = 3; // without a new row, from which the values count as old
const SPAN_S = 60; // of wall time that the charts show
const CURVES = { false: "reading", true: "setpoint" };

const byId = name => document.getElementById(name);
const stop = byId("stop"), notice = byId("notice");
const headers = { Authorization: `Bearer ${new URLSearchParams(location.search).get("token")}` };
const ask = (path, method) =>
  fetch(path, { method, headers, cache: "no-store", signal: AbortSignal.timeout(TIMEOUT_MS) });
const OTHER_STOPS = `stop it by space or q at its terminal, or by ${notice.dataset.stop}`;

let nextRow = 0, channels = [], rows = [], failures = 0, ended = false;
let charts = [], valueCells = [];

function element(name, text, className) {
  const node = document.createElement(name);
  node.textContent = text;
  if (className) node.className = className;
  return node;
}

// Sets the text of a node only where it differs, so that a screen reader does not read it twice.
function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function duration(seconds) {
  if (seconds === null) return "";
  const whole = Math.round(seconds), twoDigits = number => String(number).padStart(2, "0");
  const minutes = Math.floor(whole / 60) % 60, hours = Math.floor(whole / 3600);
  return hours ? `${hours}:${twoDigits(minutes)}:${twoDigits(whole % 60)}` : `${minutes}:${twoDigits(whole % 60)}`;
}

function valueText(value, unit) {
  if (value === null) return "no value";
  return unit ? value.toFixed(3) : String(value);
}

const degreesText = (value, digits) => value === null ? "no value" : `${value.toFixed(digits)} \u00b0C`;

// -- the run ---------------------------------------------------------------------------------------------------------

function showRun(run) {
  setText(byId("title"), run.title);
  document.title = run.title;
  setText(byId("step"), run.step || "starting");
  setText(byId("pause"), run.prompt ? `${run.prompt} (answer at the run's terminal)` : run.pause);
  byId("share").value = run.share;
  const remaining = run.ended || run.left_s === null ? "" : `, ${duration(run.left_s)} left`;
  const done = `${Math.round(100 * run.share)} %, ${duration(run.done_s)} of ${duration(run.total_s)}`;
  setText(byId("times"), `${done}${remaining}`);
  showWarnings(run.warnings, run.warnings_before);
  showWindings(run.windings);
  if (run.stopping) showStopping();
}

let warningsShown = 0;
function showWarnings(warnings, omittedCount) {
  byId("no-warnings").hidden = omittedCount + warnings.length > 0;
  const fresh = omittedCount + warnings.length - warningsShown;
  if (fresh > 0)
    byId("warnings").prepend(...warnings.slice(-fresh).reverse().map(text => element("li", text, "warning")));
  warningsShown += fresh;
}

function showWindings(windings) {
  byId("windings").replaceChildren(...windings.map(winding => {
    const row = element("tr", ""), name = element("th", winding.role), bound = element("td", "");
    name.scope = "row";
    const meter = document.createElement("meter");
    meter.max = winding.limit_degC;
    meter.high = 0.9 * winding.limit_degC;
    meter.value = winding.bound_degC;
    meter.setAttribute("aria-label", `${winding.role} winding`);
    bound.append(`${degreesText(winding.bound_degC, 1)} `, meter);
    row.append(name, bound, element("td", degreesText(winding.limit_degC, 0)),
      element("td", duration(winding.to_limit_s)), element("td", degreesText(winding.estimate_degC, 1)));
    return row;
  }));
}

// -- channels --------------------------------------------------------------------------------------------------------

function setUpChannels(newChannels) {
  channels = newChannels;
  const titles = [...new Set(channels.map(channel => channel.chart))];
  charts = titles.map(title => new Chart(title));
  byId("choice").replaceChildren(...charts.map(chart => chart.choice));
  byId("charts").replaceChildren(...charts.map(chart => chart.node));
  valueCells = channels.map(() => element("td", "", "value"));
  byId("values").replaceChildren(...channels.map((channel, k) => {
    const row = element("tr", ""), name = element("th", channel.name);
    name.scope = "row";
    row.append(name, valueCells[k], element("td", channel.unit));
    return row;
  }));
}

class Chart {
  constructor(title) {
    const members = channels.map((channel, k) => [channel, k]).filter(([channel]) => channel.chart === title);
    this.channelIndices = members.map(([, k]) => k);
    this.node = byId("chart").content.firstElementChild.cloneNode(true);
    this.grid = this.node.querySelector(".grid");
    this.node.querySelector("h3").textContent = title;
    this.node.querySelector(".y-label").textContent = members[0][0].unit ? `in ${members[0][0].unit}` : "";
    this.node.querySelector("svg").setAttribute("aria-label", `${title} over the last minute`);
    const curve = this.node.querySelector(".curve");
    this.curves = members.map(([channel]) => {
      const path = curve.cloneNode();
      path.setAttribute("class", `curve ${CURVES[channel.is_setpoint]}`);
      return path;
    });
    curve.replaceWith(...this.curves);
    this.node.querySelector(".legend").append(...members.map(([channel]) => {
      const key = element("span", channel.name, "key");
      key.prepend(element("i", "", `swatch ${CURVES[channel.is_setpoint]}`));
      return key;
    }));
    this.choice = element("label", title);
    this.box = document.createElement("input");
    this.box.type = "checkbox";
    this.box.checked = members.some(([channel]) => channel.drawn);
    this.box.addEventListener("change", () => this.draw());
    this.choice.prepend(this.box);
    this.node.hidden = !this.box.checked;
  }

  draw() {
    this.node.hidden = !this.box.checked;
    if (this.node.hidden || !rows.length) return;
    const from = rows[0].values[0], to = Math.max(rows[rows.length - 1].values[0], from + 1e-3);
    const finite = rows.flatMap(row => this.channelIndices.map(k => row.values[k + 1])).filter(value => value !== null);
    const least = finite.reduce((a, b) => Math.min(a, b), Infinity);
    const most = finite.reduce((a, b) => Math.max(a, b), -Infinity);
    const margin = MARGIN * (most - least) || 0.1 * Math.abs(most) || 1;
    const [low, high] = finite.length ? [least - margin, most + margin] : [0, 1];
    const across = time => FULL * (time - from) / (to - from), down = value => FULL * (high - value) / (high - low);
    this.channelIndices.forEach((k, number) => {
      let pen = "M";
      this.curves[number].setAttribute("d", rows.map(({ values }) => {
        if (values[k + 1] === null) { pen = "M"; return ""; }
        const mark = `${pen}${across(values[0]).toFixed(1)} ${down(values[k + 1]).toFixed(1)}`;
        pen = "L";
        return mark;
      }).join(""));
    });
    const columns = ticks(from, to, 5), lines = ticks(low, high, 5);
    const x = columns.map(([time]) => across(time)), y = lines.map(([value]) => down(value));
    label(this.node.querySelector(".x"), columns, "left", x.map(at => at / FULL));
    label(this.node.querySelector(".y"), lines, "top", y.map(at => at / FULL));
    this.grid.setAttribute("d", gridLines(x, y));
  }
}

function showChannels(state) {
  if (state.channels) {
    rows = [];
    setUpChannels(state.channels);
  }
  const now = performance.now() / 1000;
  rows.push(...state.rows.map(values => ({ now, values })));
  rows = rows.filter(row => row.now > now - SPAN_S);
  nextRow = state.next;
  if (!state.rows.length) return;
  const newest = rows[rows.length - 1].values.slice(1);
  newest.forEach((value, k) => setText(valueCells[k], valueText(value, channels[k].unit)));
  charts.forEach(chart => chart.draw());
}

// -- connection, STOP and the end of the run -------------------------------------------------------------------------

let stopFailure = ""; // message that the last STOP did not reach the run; empty once one did

function showStatus(state, trouble) {
  setText(byId("state"), state);
  setText(notice, [trouble, stopFailure].filter(Boolean).join(" "));
}

function showStopping() {
  stopFailure = "";
  stop.disabled = true;
  setText(stop, "STOPPING");
}

function showEnd({ status, reason, run }) {
  ended = true;
  stop.disabled = true;
  setText(stop, "ENDED");
  stopFailure = "";
  showStatus(`The run has ended: ${status}. ${run ? `Its file is ${run}. ` : ""}This page stays as it is.`, reason);
  document.title = `${status}: ${document.title}`;
}

function show(state) {
  if (state.title) showRun(state);
  showChannels(state);
  if (state.ended) showEnd(state.ended);
  else if (state.silent_s > SILENT_S)
    showStatus(
      "silent",
      `Nothing new from the run for ${duration(state.silent_s)}: these values are old. You can ${OTHER_STOPS}.`,
    );
  else showStatus(state.title ? "live" : "waits for the run", "");
}

// Returns the state of the run, an object with the status of a refusal, or null where the server does not answer.
async function fetchState() {
  try {
    const answer = await ask(`state?since=${nextRow}`, "GET");
    failures = 0;
    return answer.ok ? await answer.json() : { refused: answer.status };
  } catch (error) {
    failures += 1;
    return null;
  }
}

async function poll() {
  const answer = await fetchState();
  try {
    if (answer === null) {
      if (failures >= MOST_FAILURES)
        showStatus("not connected", `Connection lost: the run goes on. You can ${OTHER_STOPS}.`);
    } else if (answer.refused)
      showStatus("refused", "This address is of another run: take the one that the terminal shows.");
    else show(answer);
  } finally {
    if (!ended) setTimeout(poll, POLL_MS);
  }
}

stop.addEventListener("click", async () => {
  const answer = await ask("stop", "POST").catch(() => ({ ok: false }));
  if (answer.ok) showStopping();
  else stopFailure = `STOP did not reach the run: ${OTHER_STOPS}.`;
});
poll();
