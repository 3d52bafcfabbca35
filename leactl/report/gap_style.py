"""The look of a diagnosis; colours that differ for the colour-blind too (Okabe, Ito 2008)."""

from leactl.report.page_style import PAGE

STYLE = (
    PAGE
    + """
:root { --nominal: #8a949e; --calibrated: #d55e00; --augmented: #0072b2; --floor: #009e73; }
@media (prefers-color-scheme: dark) { :root { --nominal: #8a949e; --calibrated: #f08a3c; --augmented: #56b4e9;
  --floor: #2fc69b; } }
.headline { border-left: 4px solid var(--augmented); padding-left: 0.75rem; }
.lead { font-size: 1.1rem; }
.verdict { border: 1px solid currentcolor; border-radius: 4px; padding: 0 0.4em; margin-right: 0.25em; }
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
.pictures { display: grid; gap: 0.75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 30rem), 1fr)); }
.pictures .card { margin: 0; }
path.zero { stroke: var(--faint); stroke-dasharray: 4 3; }
path.measured { stroke: var(--ink); }
path.nominal { stroke: var(--nominal); fill: var(--nominal); }
path.calibrated { stroke: var(--calibrated); fill: var(--calibrated); }
path.augmented { stroke: var(--augmented); fill: var(--augmented); }
path.floor { fill: var(--floor); }
path.region { fill: var(--nominal); fill-opacity: 0.2; }
.swatch.measured { background: var(--ink); }
.swatch.nominal { background: var(--nominal); }
.swatch.calibrated { background: var(--calibrated); }
.swatch.augmented { background: var(--augmented); }
.swatch.floor { background: var(--floor); opacity: 0.6; }
.swatch.region { background: var(--nominal); opacity: 0.4; }
@media print { .causes li { break-inside: avoid; } .bar, .bar i { print-color-adjust: exact; } }
"""
)
