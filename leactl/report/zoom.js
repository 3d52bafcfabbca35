// Linked zoom of a page's charts; axes.js comes before it.
const numbers = text => text.trim().split(" ").map(Number);

class Chart {
  constructor(node) {
    this.node = node;
    this.svg = node.querySelector("svg");
    this.drawing = node.querySelector(".drawing");
    this.grid = node.querySelector(".grid");
    [this.low, this.high] = numbers(this.svg.dataset.x);
    [this.bottom, this.top] = numbers(this.svg.dataset.y);
    this.curves = [...node.querySelectorAll("path.curve")].map(path =>
      path.getAttribute("d").split(/[ML]/).slice(1).map(numbers));
  }

  across(time) { return FULL * (time - this.low) / (this.high - this.low); }
  time(across) { return this.low + (this.high - this.low) * across / FULL; }
  value(down) { return this.top - (this.top - this.bottom) * down / FULL; }

  show(from, to) {
    const left = this.across(from), width = this.across(to) - left;
    const downs = this.curves.flat().filter(([x]) => x >= left).filter(([x]) => left + width >= x).map(([, y]) => y);
    let up = 0, height = FULL;
    if (downs.length) {
      const least = downs.reduce((a, b) => Math.min(a, b)), most = downs.reduce((a, b) => Math.max(a, b));
      const room = MARGIN * (most - least) || FULL / 200;
      up = Math.max(0, least - room);
      height = Math.min(FULL, most + room) - up;
    }
    this.svg.setAttribute("viewBox", `${left} ${up} ${width} ${height}`);
    const columns = ticks(from, to, this.drawing.clientWidth > 500 ? 8 : 4);
    const rows = ticks(this.value(up + height), this.value(up), 5);
    const x = columns.map(([time]) => this.across(time));
    const y = rows.map(([value]) => FULL * (this.top - value) / (this.top - this.bottom));
    label(this.node.querySelector(".x"), columns, "left", x.map(at => (at - left) / width));
    label(this.node.querySelector(".y"), rows, "top", y.map(at => (at - up) / height));
    this.grid.setAttribute("d", gridLines(x, y));
  }

  // The values of the curves nearest to a time, as text.
  read(time) {
    const at = this.across(time);
    return this.curves.filter(points => points.length).map(points => {
      const [, down] = points.reduce((a, b) => Math.abs(a[0] - at) > Math.abs(b[0] - at) ? b : a);
      return this.value(down).toPrecision(5);
    }).join(", ");
  }
}

const charts = [...document.querySelectorAll(".chart")].map(node => new Chart(node));
const select = document.querySelector(".zoom select"), output = document.querySelector(".zoom output");
const steps = [...select.options].slice(1).map(option => [option.textContent.split(",")[0], ...numbers(option.value)]);
const whole = charts.length ? [charts[0].low, charts[0].high] : [0, 1];
let view = whole;

function zoom(from, to) {
  const width = Math.min(Math.max(to - from, (whole[1] - whole[0]) * 1e-6), whole[1] - whole[0]);
  const start = Math.min(Math.max(from, whole[0]), whole[1] - width);
  view = [start, start + width];
  charts.forEach(chart => chart.show(...view));
}

const ACTIONS = {
  whole: () => zoom(...whole),
  in: (width, centre) => zoom(centre - width / 4, centre + width / 4),
  out: (width, centre) => zoom(centre - width, centre + width),
  earlier: width => zoom(view[0] - width / 2, view[1] - width / 2),
  later: width => zoom(view[0] + width / 2, view[1] + width / 2),
};
document.querySelectorAll("[data-zoom]").forEach(button => button.addEventListener("click", () =>
  ACTIONS[button.dataset.zoom](view[1] - view[0], (view[0] + view[1]) / 2)));
select.addEventListener("change", () => select.value ? zoom(...numbers(select.value)) : zoom(...whole));

charts.forEach(chart => {
  const area = chart.drawing;
  let from = null, selection = null;
  const time = event => {
    const box = area.getBoundingClientRect();
    const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1);
    return view[0] + (view[1] - view[0]) * share;
  };
  const share = at => 100 * (at - view[0]) / (view[1] - view[0]);
  const end = () => { if (selection) selection.remove(); from = selection = null; };
  area.addEventListener("pointerdown", event => {
    from = time(event);
    area.setPointerCapture(event.pointerId);
    selection = document.createElement("div");
    selection.className = "selection";
    area.append(selection);
  });
  area.addEventListener("pointermove", event => {
    const at = time(event);
    const inside = steps.find(([, start, stop]) => at >= start ? stop > at : false);
    output.textContent = `${at.toPrecision(7)} s${inside ? `, ${inside[0]}` : ""}: ${chart.read(at)}`;
    if (from === null) return;
    selection.style.left = `${Math.min(share(from), share(at))}%`;
    selection.style.width = `${Math.abs(share(at) - share(from))}%`;
  });
  area.addEventListener("pointerup", event => {
    if (from === null) return;
    const [a, b] = [from, time(event)].sort((p, q) => p - q);
    end();
    if (b - a > (view[1] - view[0]) / 100) zoom(a, b);
  });
  area.addEventListener("pointercancel", end);
  area.addEventListener("dblclick", () => zoom(...whole));
});
zoom(...whole);
