"""The look of every page, light, dark and on paper, and of the curves of a run's channels."""

PAGE = """
:root { color-scheme: light dark; --ground: #ffffff; --card: #f6f7f8; --ink: #1b1f23; --faint: #5b6570;
  --line: #d5dade; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171a; --card: #1d2125; --ink: #e6e9ec; --faint: #9aa5b0;
  --line: #363d44; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 75rem; margin: 0 auto; padding: 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0.5rem 0 1rem; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 0 0 0.5rem; display: flex; flex-wrap: wrap; gap: 0 1rem; align-items: baseline; }
small, .about, figcaption, summary { color: var(--faint); font-size: 0.875rem; font-weight: normal; }
p { margin: 0.25rem 0; max-width: 75ch; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: 0.75rem; min-width: 0; }
.card + .card { margin-top: 0.75rem; }
.pair { display: grid; gap: 1rem; align-items: end;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); }
figure { margin: 0; min-width: 0; }
.chart { display: grid; grid-template-columns: 3.75rem minmax(0, 1fr); font-size: 0.75rem;
  font-variant-numeric: tabular-nums; }
.legend, .y-label { grid-column: 1 / -1; }
.y-label, .x-label { color: var(--faint); }
.y-label { margin-bottom: 0.4rem; }
.legend { display: flex; flex-wrap: wrap; gap: 0 1rem; }
.key { display: inline-flex; align-items: center; gap: 0.35rem; }
.swatch { width: 1rem; height: 0.6rem; border-radius: 2px; }
.drawing { grid-column: 2; height: 14rem; border: 1px solid var(--line); }
.drawing { position: relative; overflow: hidden; }
.on-line { position: absolute; transform: translate(-50%, -50%); background: var(--ground); padding: 0 0.15rem;
  font-size: 0.65rem; line-height: 1.1; white-space: nowrap; opacity: 0.85; }
.drawing svg { display: block; width: 100%; height: 100%; }
.x, .y { position: relative; }
.y span { position: absolute; right: 0.4rem; transform: translateY(-50%); white-space: nowrap; }
.x { grid-column: 2; height: 1.2rem; }
.x span { position: absolute; transform: translateX(-50%); white-space: nowrap; }
.x-label { grid-column: 2; text-align: center; }
path { vector-effect: non-scaling-stroke; }
.curve { fill: none; stroke-width: 1.5; stroke-linejoin: round; }
.grid { fill: none; stroke: var(--line); stroke-width: 1; }
.area { stroke: none; fill-opacity: 0.3; }
svg path.curve { fill: none; }
svg path.area { stroke: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.875rem; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
th, td { text-align: left; padding: 0.2rem 0.9rem 0.2rem 0; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 500; }
thead th { color: var(--faint); }
details, .scroll { margin-top: 0.75rem; }
@media print { body { font-size: 11pt; } details::details-content { content-visibility: visible; }
  .card, figure { break-inside: avoid; } .swatch { print-color-adjust: exact; } .scroll { overflow: visible; } }
"""

CHANNELS = """
:root { --reading: #1f6fb4; --setpoint: #c2570c; }
@media (prefers-color-scheme: dark) { :root { --reading: #6cb2f0; --setpoint: #f0954a; } }
path.reading { stroke: var(--reading); } path.setpoint { stroke: var(--setpoint); }
.swatch.reading { background: var(--reading); } .swatch.setpoint { background: var(--setpoint); }
"""
