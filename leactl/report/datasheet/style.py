"""The look of a datasheet; series in colours that differ for the colour-blind too (Okabe, Ito 2008)."""

from leactl.report.page_style import PAGE

# of a map's bands, lowest first: greys where both sides lose power, above them viridis (Smith, van der Walt 2015)
BANDS = (
    *("#555555", "#888888", "#bbbbbb"),
    *("#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26"),
    "#fde725",
)
BAND_COLOURS = "".join(
    f"path.band.b{k} {{ fill: {colour}; stroke: {colour}; }} .swatch.b{k} {{ background: {colour}; }}\n"
    for k, colour in enumerate(BANDS)
)
STYLE = (
    PAGE
    + BAND_COLOURS
    + """
:root { --s0: #0072b2; --s1: #d55e00; --s2: #009e73; --s3: #b0568c; --s4: #a87400; --s5: #3a8fc2; }
@media (prefers-color-scheme: dark) { :root { --s0: #56b4e9; --s1: #f08a3c; --s2: #2fc69b; --s3: #dd9cc2;
  --s4: #e0b040; --s5: #9fd4f5; } }
a { color: var(--s0); }
section h3 { margin-top: 2rem; font-size: 1.1rem; }
.pair { align-items: start; gap: 1.5rem 2rem; margin-top: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 26rem), 1fr)); }
.pair + .pair { margin-top: 2rem; }
.pair .pair { margin-top: 0; }
figcaption { margin-bottom: 0.4rem; }
.s0 { color: var(--s0); } .s1 { color: var(--s1); } .s2 { color: var(--s2); }
.s3 { color: var(--s3); } .s4 { color: var(--s4); } .s5 { color: var(--s5); }
.other, .paper { color: var(--faint); }
path.line { stroke: currentcolor; stroke-width: 1.5; }
path.thin { stroke-width: 1; stroke-dasharray: 4 3; }
path.marks { fill: none; stroke: currentcolor; stroke-width: 7; stroke-linecap: round; }
path.marks.fine { stroke-width: 3; }
path.marks.square { stroke-linecap: square; stroke-width: 5.5; }
path.marks.ring { stroke-width: 9; }
path.marks.hole { stroke: var(--ground); stroke-width: 5; }
path.paper { stroke: currentcolor; stroke-width: 1.5; stroke-dasharray: 3 2; }
.swatch { background: currentcolor; }
.swatch.line { height: 0; border-top: 2px solid currentcolor; background: none; }
.swatch.thin { border-top: 1px dashed currentcolor; }
.swatch.paper { width: 0; height: 0.9rem; border-left: 2px dashed currentcolor; background: none; }
.swatch.dot, .swatch.ring, .swatch.square, .swatch.fine { width: 0.6rem; border-radius: 50%; }
.swatch.square { border-radius: 0; }
.swatch.ring { background: none; border: 2px solid currentcolor; }
.swatch.fine { width: 0.35rem; height: 0.35rem; }
.key { color: var(--ink); }
.strips { grid-template-columns: minmax(5rem, max-content) minmax(0, 1fr); align-items: center; gap: 0 0.5rem; }
.strip-label { text-align: right; }
.strip { display: block; width: 100%; height: 1.6rem; border-left: 1px solid var(--line); }
path.band { stroke-width: 0.6; stroke-linejoin: round; }
path.contour { stroke: var(--ink); stroke-width: 0.8; }
.lacking td, .lacking th { color: var(--faint); }
.map thead th { white-space: normal; vertical-align: bottom; }
.wrap { white-space: normal; min-width: 8rem; }
.second { display: block; color: var(--faint); }
.fault { display: block; white-space: normal; min-width: 14rem; }
ul.about { margin: 0.25rem 0; max-width: 75ch; }
.facts { display: grid; grid-template-columns: max-content minmax(0, 1fr); gap: 0 1rem; margin: 0.25rem 0; }
.facts dt { color: var(--faint); }
.facts dd { margin: 0; }
@media screen and (max-width: 40rem) {
  table.datasheet, .datasheet tbody, .datasheet tr { display: block; }
  .datasheet thead { position: absolute; clip-path: inset(50%); }
  .datasheet tr { padding: 0.5rem 0; border-bottom: 1px solid var(--line); }
  .datasheet th, .datasheet td { display: block; border: 0; padding: 0.1rem 0; white-space: normal;
    overflow-wrap: anywhere; }
  .datasheet td { display: grid; grid-template-columns: 9rem minmax(0, 1fr); }
  .datasheet td::before { content: attr(data-label); color: var(--faint); }
  .datasheet td:empty { display: none; } }
@page { size: A4; margin: 14mm; }
@media print { :root { --card: #ffffff; } main { max-width: none; padding: 0; }
  h2, h3, .method { break-after: avoid; break-inside: avoid; }
  tr, figure { break-inside: avoid; } th, .wrap { white-space: normal; min-width: 0; }
  th, td { padding-right: 0.4rem; } table { font-size: 8pt; }
  .drawing { height: 5cm; } .pair { grid-template-columns: 1fr 1fr; gap: 1rem; }
  path, .swatch { print-color-adjust: exact; } }
"""
)
