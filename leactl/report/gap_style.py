"""The look of the page, light, dark and on paper; colours that differ for the colour-blind too (Okabe, Ito 2008)."""

STYLE = """
:root { color-scheme: light dark; --ground: #ffffff; --card: #f6f7f8; --ink: #1b1f23; --faint: #5b6570;
  --line: #d5dade; --nominal: #8a949e; --calibrated: #d55e00; --augmented: #0072b2; --floor: #009e73; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171a; --card: #1d2125; --ink: #e6e9ec; --faint: #9aa5b0;
  --line: #363d44; --nominal: #8a949e; --calibrated: #f08a3c; --augmented: #56b4e9; --floor: #2fc69b; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 75rem; margin: 0 auto; padding: 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0.5rem 0 1rem; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 0 0 0.5rem; display: flex; flex-wrap: wrap; gap: 0 1rem; align-items: baseline; }
small, .about, figcaption, summary { color: var(--faint); font-size: 0.875rem; font-weight: normal; }
p { margin: 0.25rem 0; max-width: 75ch; }
.headline { border-left: 4px solid var(--augmented); padding-left: 0.75rem; }
.lead { font-size: 1.1rem; }
.verdict { border: 1px solid currentcolor; border-radius: 4px; padding: 0 0.4em; margin-right: 0.25em; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: 0.75rem; min-width: 0; }
.card + .card { margin-top: 0.75rem; }
.bar { background: var(--line); height: 0.75rem; border-radius: 2px; overflow: hidden; }
.bar i { display: block; height: 100%; background: var(--augmented); }
.bar.weak i { background: var(--nominal); }
.causes { list-style: none; margin: 0; padding: 0; display: grid; gap: 0.75rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
.causes li { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: 0.75rem; }
.row { display: flex; justify-content: space-between; gap: 1rem; }
.name { font-weight: 600; }
dl { display: grid; grid-template-columns: auto 1fr; gap: 0 1rem; margin: 0.25rem 0; }
dt { color: var(--faint); }
dd { margin: 0; font-variant-numeric: tabular-nums; }
.shrinkage { display: grid; gap: 0.75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
.shrinkage .card { margin: 0; }
.shrinkage + p { margin-top: 0.75rem; }
.bars { display: grid; grid-template-columns: auto 1fr auto; gap: 0.15rem 0.5rem; align-items: center;
  font-size: 0.875rem; font-variant-numeric: tabular-nums; }
.bars .bar { background: none; }
.bars .nominal { background: var(--nominal); }
.bars .calibrated { background: var(--calibrated); }
.bars .augmented { background: var(--augmented); }
.bars .floor { background: var(--floor); }
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
path.measured { stroke: var(--ink); }
path.nominal { stroke: var(--nominal); fill: var(--nominal); }
path.calibrated { stroke: var(--calibrated); fill: var(--calibrated); }
path.augmented { stroke: var(--augmented); fill: var(--augmented); }
path.curve { fill: none; }
path.area { stroke: none; }
path.floor { fill: var(--floor); }
path.region { fill: var(--nominal); fill-opacity: 0.2; }
.swatch.measured { background: var(--ink); }
.swatch.nominal { background: var(--nominal); }
.swatch.calibrated { background: var(--calibrated); }
.swatch.augmented { background: var(--augmented); }
.swatch.floor { background: var(--floor); opacity: 0.6; }
.swatch.region { background: var(--nominal); opacity: 0.4; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.875rem; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
th, td { text-align: left; padding: 0.2rem 0.9rem 0.2rem 0; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 500; }
thead th { color: var(--faint); }
details, .scroll { margin-top: 0.75rem; }
@media print { body { font-size: 11pt; } details::details-content { content-visibility: visible; }
  .card, .causes li, figure { break-inside: avoid; }
  .bar, .bar i, .swatch { print-color-adjust: exact; } .scroll { overflow: visible; } }
"""
