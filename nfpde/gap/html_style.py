"""The look of the page: one style sheet, light and dark, wide and narrow."""

# the colours are of the set by Okabe and Ito (Color Universal Design, 2008), lightened for the dark page
STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#5c6670;--page:#fff;--card:#f5f6f8;--rule:#d6dadf;--blue:#0072b2;
--red:#d55e00;--green:#00795a;--body:#c3cad2;--edge:#6c7782;--idle:#8a949e;--track:#e3e7eb}
@media (prefers-color-scheme:dark){:root{--ink:#e8ebee;--soft:#a3adb7;--page:#14171a;--card:#1d2226;--rule:#363d44;
--blue:#56b4e9;--red:#f28a3c;--green:#2fbf95;--body:#3a434c;--edge:#8d99a5;--idle:#77828c;--track:#30373d}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,
"Helvetica Neue",Arial,sans-serif;overflow-wrap:anywhere}
main{max-width:1160px;margin:0 auto;padding:20px 18px 60px}
h1{font-size:1.75rem;line-height:1.25;margin:.3em 0 .5em}h2{font-size:1.2rem;margin:2.2em 0 .4em}
p,ul,ol{margin:.5em 0;max-width:78ch}ul,ol{padding-left:1.3em}.soft{color:var(--soft)}small,.small{font-size:.86rem}
.badge{display:inline-block;padding:2px 12px;border-radius:99px;font-weight:600;font-size:.86rem;border:2px solid}
.effects,.no_gap{color:var(--green)}.badge.unexplained,.flag{color:var(--red)}.flag{font-weight:600}
.cols{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr));gap:0 32px}
.cols>*{min-width:0}
.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,330px),1fr));gap:12px;max-width:1160px}
.panels>svg{background:var(--card);border-radius:8px;width:100%;max-width:560px;height:auto;padding:6px}
.panels.one{max-width:450px}
svg text{font-size:12px;fill:var(--ink)}svg .title{font-weight:600}svg .end{text-anchor:end}svg .mid{text-anchor:middle}
.grid{stroke:var(--rule);fill:none;stroke-width:.7}.line{fill:none;stroke-width:2;stroke-linejoin:round}
.bar{fill:none;stroke-width:1;opacity:.55}
.line.measured{stroke:var(--ink);stroke-width:3;opacity:.45}.line.before{stroke:var(--red);stroke-dasharray:6 3}
.line.after{stroke:var(--blue)}.line.floor{stroke:var(--green);stroke-dasharray:2 3}
.line.nominal{stroke:var(--idle)}.bar.after{stroke:var(--blue)}.dot.after{fill:var(--blue)}.dot.before{fill:var(--red)}
.dot.floor{fill:var(--green)}.dot.nominal{fill:var(--idle)}
.key{display:flex;flex-wrap:wrap;gap:4px 18px;margin:.4em 0;font-size:.9rem}.key svg{width:34px;height:12px;
vertical-align:middle;margin-right:6px}
.scroll{overflow-x:auto;max-width:100%}table{border-collapse:collapse;font-size:.92rem;margin:.5em 0}
th,td{text-align:left;padding:6px 12px 6px 0;border-bottom:1px solid var(--rule);vertical-align:top;
overflow-wrap:normal}th{font-weight:600;color:var(--soft);font-size:.84rem}
td.name,.causes td:nth-child(2){min-width:15ch}.causes td:nth-child(3){min-width:170px}
.causes td:nth-child(4){min-width:21ch}.causes{width:100%}
.track{position:relative;height:12px;background:var(--track);border-radius:3px;margin:5px 0 3px}
.track i{position:absolute;top:0;bottom:0;left:0;background:var(--blue);border-radius:3px}
.track b{position:absolute;top:4px;height:4px;background:var(--ink);opacity:.75}
.ladder{display:grid;grid-template-columns:minmax(90px,max-content) 1fr 62px;gap:7px 12px;align-items:center;
max-width:640px}.ladder .track{height:24px;margin:0}.ladder .track u{position:absolute;top:0;bottom:0;width:1px;
background:var(--page);opacity:.8}.ladder .value{font-weight:600;text-align:right;white-space:nowrap}
.ladder .floor i{background:var(--green)}.ladder .start i{background:var(--red)}.ladder .axis{position:relative;
height:18px;font-size:.78rem;color:var(--soft)}.axis span{position:absolute;transform:translateX(-50%);
white-space:nowrap}.ladder .label{max-width:230px}
.robot{min-width:430px;width:100%;max-width:820px;height:auto;display:block}
.robot .solid{fill:var(--body);stroke:var(--edge);stroke-width:1.2;fill-opacity:.75;stroke-linejoin:round}
.robot .fixed{fill:var(--track);stroke:var(--rule)}.robot .lead{stroke:var(--idle);fill:none;stroke-width:.8}
.robot .disc{stroke:var(--ink);stroke-width:1.3}.robot .bare{fill:var(--page)}.robot .ground{stroke:var(--idle);
stroke-width:1.5;stroke-dasharray:8 4}.robot text{font-size:14.5px}.robot .much{font-weight:700}
.robot .little{fill:var(--soft)}
.scale{display:inline-block;width:120px;height:11px;border-radius:3px;vertical-align:middle;margin:0 7px}
.map .first{border-left:3px solid var(--rule)}
.map td,.map th{padding:6px 9px;border:1px solid var(--rule);text-align:center}.map th[scope=row]{text-align:left;
color:var(--ink);font-size:.92rem}
.card{background:var(--card);border-radius:8px;padding:10px 16px;margin:10px 0;max-width:84ch}
dl{display:grid;grid-template-columns:max-content 1fr;gap:3px 18px;margin:.5em 0}dt{color:var(--soft)}dd{margin:0}
details{margin:.6em 0}summary{cursor:pointer;color:var(--blue)}
@media (max-width:640px){body{font-size:15px}h1{font-size:1.4rem}main{padding:12px 12px 40px}
.ladder{grid-template-columns:1fr 62px}.ladder .label{grid-column:1/3;max-width:none}.ladder .gone{display:none}
.robot{min-width:0}.causes thead{display:none}.causes td{display:block;border:0;padding:1px 0}.causes tr{display:block;
border-bottom:1px solid var(--rule);padding:8px 0}.causes td:first-child{float:left;padding-right:8px}}
@media print{.scroll{overflow:visible}}
"""
