"""The report in a real browser: it runs without an error or a fetch, and its controls do what they say.

What carries the weight: the same look at the console finds an error, a rejection and a blocked fetch that are put in
on purpose.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fretflow_post.report import render_report

pytestmark = pytest.mark.render

HERE = Path(__file__).parent
CHROMIUM = shutil.which("chromium")
# What a user would do, one after another; what is read off goes to the end of the page.
VISIT = """<script>
{
const said = [];
const move = (chart, x, y) => {
  const at = new DOMPoint(x, y).matrixTransform(chart.getScreenCTM());
  chart.dispatchEvent(new PointerEvent("pointermove", { clientX: at.x, clientY: at.y }));
  return chart.parentElement.querySelector(".readout").textContent;
};
const key = (chart, name) => {
  chart.dispatchEvent(new KeyboardEvent("keydown", { key: name }));
  return chart.parentElement.querySelector(".readout").textContent;
};
const shown = () => [...document.querySelectorAll(".loop")].filter((e) => getComputedStyle(e).display !== "none");
const loop = document.querySelector("#loop-0 svg[data-readout=curves]");
const map = document.querySelector("svg[data-readout=map]");
said.push(`shown ${shown().map((e) => e.id)}`);
said.push(`loop ${move(loop, 0, 0)}`);
said.push(`next ${key(loop, "ArrowRight")}`);
const [left, top, width, height] = map.dataset.box.split(" ").map(Number);
said.push(`map ${move(map, left + 0.5 * width, top + 0.5)}`);
said.push(`down ${key(map, "ArrowDown")}`);
const choices = document.querySelectorAll("input[name=loop]");
choices[3].click();
said.push(`shown ${shown().map((e) => e.id)}`);
document.querySelector("input[data-curve=before]").click();
const visible = (look) => getComputedStyle(document.querySelector(`#loop-3 .curve.${look}`)).visibility;
said.push(`before ${visible("before")}, after ${visible("after")}`);
const folding = [...document.querySelectorAll("#sure figure tbody tr")];
const rows = () => folding.filter((e) => e.offsetParent !== null).length;
const folded = rows();
document.querySelector("button[data-unfold]").click();
said.push(`rows ${folded} ${rows()}`);
said.push(`wide ${document.documentElement.scrollWidth <= document.documentElement.clientWidth}`);
const list = document.createElement("ul");
list.id = "said";
for (const line of said) list.appendChild(document.createElement("li")).textContent = line;
document.body.appendChild(list);
}
</script></body>"""


@pytest.fixture
def cases(monkeypatch):
    monkeypatch.syspath_prepend(HERE)
    import report_cases

    return report_cases


@pytest.fixture
def visit(tmp_path):
    """Return a function that opens a page and returns the text of its document and the lines of its console."""
    if CHROMIUM is None:
        pytest.skip("needs the Debian package chromium, which `./fretflow test` installs")

    def run(text, width=1200):
        page = tmp_path / "report.html"
        page.write_text(text, encoding="utf-8")
        done = subprocess.run(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
             "--disable-background-networking", f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},900",
             "--enable-logging=stderr", "--virtual-time-budget=3000", "--dump-dom", page.as_uri()],
            capture_output=True, text=True, timeout=60, check=True, env={**os.environ, "HOME": str(tmp_path)})
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return run


@pytest.mark.parametrize(("maker", "kind"), [
    ("named", "fretting-rig"), ("none", "imposed-displacement"), ("ambiguous", "fretting-rig"), ("unknown", "lumped"),
])
def test_each_verdict_is_shown_without_an_error(maker, kind, cases, visit):
    found = getattr(cases, maker)(kind)
    document, console = visit(render_report(found))
    assert console == []
    assert '<html lang="en" class="live">' in document
    assert found.sentence in document.replace("&nbsp;", " ")  # between a number and its unit
    assert document.count('class="at ') > 5, "the script has put its marks into the charts"


def test_odd_values_and_text_do_no_harm(cases, visit):
    document, console = visit(render_report(cases.odd()))
    assert console == []
    assert "<b>&amp;" not in document
    assert document.count('class="at ') > 5


def said(document):
    items = re.search(r'<ul id="said">(.*?)</ul>', document)[1]
    return [line.partition(" ")[::2] for line in re.findall(r"<li>(.*?)</li>", items)]


@pytest.mark.parametrize("width", [1200, 500])
def test_the_controls_do_what_they_say(width, cases, visit):
    found = cases.named()
    document, console = visit(render_report(found).replace("</body>", VISIT), width)
    assert console == []
    told = said(document)
    assert [value for name, value in told if name == "shown"] == ["loop-0", "loop-3"]
    answers = dict(told)
    number = r"([−\d.]+)"
    one = found.comparisons[0]
    records = np.array([one.displacement * 1e6, one.force, one.before_displacement * 1e6, one.before_force,
                        one.after_displacement * 1e6, one.after_force])
    read = re.compile("; ".join(f"{name} {number} µm, {number} N" for name in ("measured", "before", "after")))
    places = []
    for answer in (answers["loop"], answers["next"]):
        values = np.array([float(v.replace("−", "-")) for v in read.fullmatch(answer).groups()])
        places.append(int(np.argmin(np.abs(records[0] - values[0]) + np.abs(records[1] - values[1]))))
        assert records[:, places[-1]] == pytest.approx(values, abs=0.2)
    assert places[1] == places[0] + 1
    row, share, value = re.fullmatch(rf"(.*), at {number} of the period: {number} sd", answers["map"]).groups()
    one = found.residual_maps[0]
    column = round(float(share) * cases.SAMPLES - 0.5)
    assert row == one.rows[0]
    assert float(value.replace("−", "-")) == pytest.approx(one.before[0, column], abs=0.06)
    assert answers["down"].startswith(f"{one.rows[1]}, at {share}")
    assert answers["before"] == "hidden, after visible"
    assert answers["rows"] == f"8 {len(found.ranking)}"
    assert answers["wide"] == "true", "the page is no wider than the window"


@pytest.mark.parametrize(("flaw", "message"), [
    ("<script>throw new Error('a flaw')</script>", "Uncaught Error: a flaw"),
    ("<script>Promise.reject(new Error('a refusal'))</script>", "a refusal"),
    ('<img src="https://example.org/a.png">', "Content Security Policy"),
])
def test_a_flaw_would_be_seen(flaw, message, cases, visit):
    _, console = visit(render_report(cases.empty()).replace("</body>", f"{flaw}</body>"))
    assert any(message in line for line in console)
