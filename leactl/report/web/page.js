// A run as it goes, asked for from its server twice a second; axes.js comes before it. The state keeps its last values
// when the server has gone, and every text of the run is set as text.
const EVERY_MS = 500, PATIENCE_MS = 3000;
const FAILURES = 2; // in a row, from which the connection counts as lost
const SILENT_S = 3; // without a new cycle of the loop, from which the values count as old
const SPAN_S = 60; // of wall time that the charts keep
const CURVES = { false: "reading", true: "setpoint" };

const byId = name => document.getElementById(name);
const stop = byId("stop"), notice = byId("notice");
const headers = { Authorization: `Bearer ${new URLSearchParams(location.search).get("token")}` };
const ask = (path, method) =>
  fetch(path, { method, headers, cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) });
const OTHERWISE = `stop it by space or q at its terminal, or by ${notice.dataset.stop}`;

let next = 0, channels = [], rows = [], failures = 0, ended = false;
let charts = [], valueCells = [];

function element(name, text, className) {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

// A text that is set only where it has changed, so that a screen reader is not given it twice.
function put(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function duration(seconds) {
  if (seconds === null) return "";
  const whole = Math.round(seconds), two = number => String(number).padStart(2, "0");
  const minutes = Math.floor(whole / 60) % 60, hours = Math.floor(whole / 3600);
  return hours ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
}

function shown(value, unit) {
  if (value === null) return "no value";
  return unit ? value.toFixed(3) : String(value);
}

const degrees = (value, digits) => value === null ? "no value" : `${value.toFixed(digits)} \u00b0C`;

// -- the run ---------------------------------------------------------------------------------------------------------

function showRun(run) {
  put(byId("title"), run.title);
  document.title = run.title;
  put(byId("step"), run.step || "starting");
  put(byId("pause"), run.prompt ? `${run.prompt} (answer at the run's terminal)` : run.pause);
  byId("share").value = run.share;
  const left = run.ended || run.left_s === null ? "" : `, ${duration(run.left_s)} left`;
  put(byId("times"), `${Math.round(100 * run.share)} %, ${duration(run.done_s)} of ${duration(run.total_s)}${left}`);
  showWarnings(run.warnings, run.warnings_before);
  showWindings(run.windings);
  if (run.stopping) askedToStop();
}

let warningsShown = 0;
function showWarnings(warnings, before) {
  byId("no-warnings").hidden = before + warnings.length > 0;
  const fresh = before + warnings.length - warningsShown;
  if (fresh > 0) byId("warnings").prepend(...warnings.slice(-fresh).reverse().map(text => element("li", text, "warning")));
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
    bound.append(`${degrees(winding.bound_degC, 1)} `, meter);
    row.append(name, bound, element("td", degrees(winding.limit_degC, 0)),
      element("td", duration(winding.to_limit_s)), element("td", degrees(winding.estimate_degC, 1)));
    return row;
  }));
}

// -- channels --------------------------------------------------------------------------------------------------------

function setUp(given) {
  channels = given;
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
    const places = channels.map((channel, k) => [channel, k]).filter(([channel]) => channel.chart === title);
    this.places = places.map(([, k]) => k);
    this.node = byId("chart").content.firstElementChild.cloneNode(true);
    this.grid = this.node.querySelector(".grid");
    this.node.querySelector("h3").textContent = title;
    this.node.querySelector(".y-label").textContent = places[0][0].unit ? `in ${places[0][0].unit}` : "";
    this.node.querySelector("svg").setAttribute("aria-label", `${title} over the last minute`);
    const curve = this.node.querySelector(".curve");
    this.curves = places.map(([channel]) => {
      const path = curve.cloneNode();
      path.setAttribute("class", `curve ${CURVES[channel.is_setpoint]}`);
      return path;
    });
    curve.replaceWith(...this.curves);
    this.node.querySelector(".legend").append(...places.map(([channel]) => {
      const key = element("span", channel.name, "key");
      key.prepend(element("i", "", `swatch ${CURVES[channel.is_setpoint]}`));
      return key;
    }));
    this.choice = element("label", title);
    this.box = document.createElement("input");
    this.box.type = "checkbox";
    this.box.checked = places.some(([channel]) => channel.drawn);
    this.box.addEventListener("change", () => this.draw());
    this.choice.prepend(this.box);
    this.node.hidden = !this.box.checked;
  }

  draw() {
    this.node.hidden = !this.box.checked;
    if (this.node.hidden || !rows.length) return;
    const from = rows[0].values[0], to = Math.max(rows[rows.length - 1].values[0], from + 1e-3);
    const finite = rows.flatMap(row => this.places.map(k => row.values[k + 1])).filter(value => value !== null);
    const least = finite.reduce((a, b) => Math.min(a, b), Infinity);
    const most = finite.reduce((a, b) => Math.max(a, b), -Infinity);
    const room = MARGIN * (most - least) || 0.1 * Math.abs(most) || 1;
    const [low, high] = finite.length ? [least - room, most + room] : [0, 1];
    const across = time => FULL * (time - from) / (to - from), down = value => FULL * (high - value) / (high - low);
    this.places.forEach((k, number) => {
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
    setUp(state.channels);
  }
  const now = performance.now() / 1000;
  rows.push(...state.rows.map(values => ({ now, values })));
  rows = rows.filter(row => row.now > now - SPAN_S);
  next = state.next;
  if (!state.rows.length) return;
  rows[rows.length - 1].values.slice(1).forEach((value, k) => put(valueCells[k], shown(value, channels[k].unit)));
  charts.forEach(chart => chart.draw());
}

// -- how it goes on, and how it ends -----------------------------------------------------------------------------------

let unheard = ""; // that a STOP was not taken, until one is

function say(state, trouble) {
  put(byId("state"), state);
  put(notice, [trouble, unheard].filter(Boolean).join(" "));
}

function askedToStop() {
  unheard = "";
  stop.disabled = true;
  put(stop, "STOPPING");
}

function end({ status, reason, run }) {
  ended = true;
  stop.disabled = true;
  put(stop, "ENDED");
  unheard = "";
  say(`The run has ended: ${status}. ${run ? `Its file is ${run}. ` : ""}This page stays as it is.`, reason);
  document.title = `${status}: ${document.title}`;
}

function show(state) {
  if (state.title) showRun(state);
  showChannels(state);
  if (state.ended) end(state.ended);
  else if (state.silent_s > SILENT_S)
    say("silent", `Nothing new from the run for ${duration(state.silent_s)}: these values are old. To stop it, ${OTHERWISE}.`);
  else say(state.title ? "live" : "waits for the run", "");
}

// What the server answers; null where it does not.
async function state() {
  try {
    const answer = await ask(`state?since=${next}`, "GET");
    failures = 0;
    return answer.ok ? await answer.json() : { refused: answer.status };
  } catch (error) {
    failures += 1;
    return null;
  }
}

async function poll() {
  const answer = await state();
  try {
    if (answer === null) {
      if (failures >= FAILURES) say("not connected", `Connection lost: the run goes on. To stop it, ${OTHERWISE}.`);
    } else if (answer.refused) say("refused", "This address is of another run: take the one that the terminal shows.");
    else show(answer);
  } finally {
    if (!ended) setTimeout(poll, EVERY_MS);
  }
}

stop.addEventListener("click", async () => {
  const answer = await ask("stop", "POST").catch(() => ({ ok: false }));
  if (answer.ok) askedToStop();
  else unheard = `STOP did not reach the run: ${OTHERWISE}.`;
});
poll();
