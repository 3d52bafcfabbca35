"use strict";
// Axes of charts in a page. The page is XML too, so that this text and those that follow it hold neither of the two
// signs that open markup there: conditions are written with the greater sign alone.
const FULL = 1000; // units of each drawing, across and down, as chart.py draws them
const MARGIN = 0.04; // of the range, free above and below

// Ticks at 1, 2 or 5 times a power of ten: value and text of each.
function ticks(low, high, most) {
  const least = (high - low) / most, power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find(factor => factor * power >= least);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const first = Math.ceil(low / step), count = Math.floor(high / step) - first + 1;
  return Array.from({ length: Math.max(0, count) }, (_, k) => {
    const value = (first + k) * step;
    return [value, digits > 6 ? value.toPrecision(4) : value.toFixed(digits)];
  });
}

function label(axis, marks, side, shares) {
  axis.replaceChildren(...marks.map(([, text], k) => {
    const span = document.createElement("span");
    span.textContent = text;
    span.style[side] = `${100 * shares[k]}%`;
    return span;
  }));
}

const gridLines = (x, y) => [...x.map(at => `M${at} 0V${FULL}`), ...y.map(at => `M0 ${at}H${FULL}`)].join("");
