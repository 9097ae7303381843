"""The report in a real browser: it runs without an error or a fetch, and its controls do what they say.

What carries the weight: the same look at the console finds an error, a rejection and a blocked fetch that are put in
on purpose.
"""

import base64
import hashlib
import os
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import report_cases
from fretflow_post.report import render_report

pytestmark = pytest.mark.render

CHROMIUM = shutil.which("chromium")
# What a user would do, one after another; what is read off goes to the end of the page.
VISIT = """
setTimeout(async () => {
const said = [];
const wait = () => new Promise((done) => setTimeout(done, 200));
const inside = (node) => [node, ...[...(node.shadowRoot?.children ?? []), ...node.children].flatMap(inside)];
const words = (node) => [...(node.shadowRoot ?? node).childNodes].map((one) => one.nodeType === 3 ? one.textContent
  : one.tagName === "STYLE" ? "" : words(one)).join(" ").replace(/\\s+/g, " ");
const tips = () => [...document.querySelectorAll(".bk-Tooltip:popover-open")].map(words);
const read = async (chart, across, down) => {
  chart.scrollIntoView();
  const [box, pad] = [chart.getBoundingClientRect(), inside(chart).find((one) => one.classList.contains("bk-events"))];
  const before = tips().length;
  for (const type of ["pointerenter", "pointermove"]) {
    pad.dispatchEvent(new PointerEvent(type, { clientX: box.left + across * box.width,
      clientY: box.top + down * box.height, bubbles: true, pointerType: "mouse", isPrimary: true }));
  }
  for (let k = 0; k < 20 && tips().length === before; k += 1) await wait();
  return tips().slice(before).join(";");
};
const waiting = (e) => e.offsetParent && !e.querySelector(".exports");
while ([...document.querySelectorAll(".chart")].some(waiting)) await wait();
const shown = () => [...document.querySelectorAll(".loop")].filter((e) => getComputedStyle(e).display !== "none");
said.push(`shown ${shown().map((e) => e.id)}`);
const difference = document.querySelector("#loop-0 .panel:nth-child(2) .chart");
said.push(`difference ${await read(difference, 0.6, 0.5)}`);
said.push(`map ${await read(document.querySelector("#where .chart"), 0.6, 0.55)}`);
const made = URL.createObjectURL;
URL.createObjectURL = (blob) => { said.push(`saved ${blob.type}, ${blob.size > 5000}`); return made.call(URL, blob); };
for (const button of difference.querySelectorAll(".exports button")) button.click();
for (let k = 0; k < 10 && said.length < 5; k += 1) await wait();
document.querySelectorAll("input[name=loop]")[3].click();
document.querySelector("input[data-curve=before]").click();
await wait();
said.push(`shown ${shown().map((e) => e.id)}`);
const curves = Bokeh.documents.flatMap((one) => [...one.all_models]).filter((one) => "muted" in one);
for (const look of ["before", "after"]) {
  said.push(`${look} ${[...new Set(curves.filter((one) => one.name === look).map((one) => one.visible))]}`);
}
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
}, 1000);
"""


def with_script(text, script):
    """Return the page with one more script, and a policy that allows it."""
    own = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (text.replace("script-src ", f"script-src 'sha256-{own}' ", 1)
            .replace("</body>", f"<script>{script}</script></body>"))


@pytest.fixture
def cases():
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
             "--enable-logging=stderr", "--virtual-time-budget=8000", "--dump-dom", page.as_uri()],
            capture_output=True, text=True, timeout=300, check=True, env={**os.environ, "HOME": str(tmp_path)})
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return run


@pytest.mark.parametrize(("maker", "kind"), [
    ("named", "fretting-rig"), ("none", "imposed-displacement"), ("ambiguous", "fretting-rig"), ("unknown", "lumped"),
])
def test_each_verdict_is_shown_without_an_error(maker, kind, cases, visit):
    diagnosis = getattr(cases, maker)(kind)
    document, console = visit(render_report(diagnosis))
    assert console == []
    assert '<html lang="en" class="live">' in document
    assert diagnosis.sentence in document.replace("&nbsp;", " ")  # between a number and its unit
    assert document.count('class="exports"') > 1, "the script has drawn the charts"
    assert 'class="exports"' not in render_report(diagnosis)


# The whole page is laid out in a frame as wide as a phone: a window of Chromium's is never narrower than 500.
PHONE = """
const frame = document.createElement("iframe");
frame.style.cssText = "width:420px;height:900px;border:0";
frame.onload = () => setTimeout(() => {
  const root = frame.contentDocument.documentElement;
  root.style.scrollbarWidth = "none";
  document.body.innerHTML = `<ul id="said"><li>wide ${root.scrollWidth} of ${root.clientWidth}</li></ul>`;
}, 1000);
frame.srcdoc = document.documentElement.outerHTML.replace(/<script[^]*?<\\/script>/g, "");
document.body.replaceChildren(frame);
"""


@pytest.mark.parametrize("maker", ["named", "none"])
def test_no_page_is_wider_than_a_phone(maker, cases, visit):
    """A label at the end of a bar stood out of the page where the model errs no more than repeats do."""
    document, _ = visit(with_script(render_report(getattr(cases, maker)()), PHONE))
    assert said(document) == [("wide", "420 of 420")]


def test_odd_values_and_text_do_no_harm(cases, visit):
    document, console = visit(render_report(cases.odd()))
    assert console == []
    assert "<b>&amp;" not in document.partition('"use strict"')[0]
    assert document.count('class="exports"') > 1


# Saves the chart in place of its page.
SAVE = """
URL.createObjectURL = (blob) => { blob.text().then((text) => { document.body.innerHTML = text; }); return "data:,"; };
const save = () => {
  const button = document.querySelector("CHART .exports button");
  if (button) button.click(); else setTimeout(save, 100);
};
save();
"""


@pytest.mark.parametrize("chart", ["#where", "#law"])
def test_no_text_is_taken_for_a_formula(chart, cases, visit):
    diagnosis = cases.unknown()
    formula = "$$x^2$$"
    maps = tuple(replace(one, rows=(formula, *one.rows[1:])) for one in diagnosis.residual_maps)
    law = replace(diagnosis.residual_law, state=formula)
    text = render_report(replace(diagnosis, residual_maps=maps, residual_law=law))
    document, console = visit(with_script(text, SAVE.replace("CHART", chart)))
    assert console == []
    assert re.search(r"<text[^>]*>[^<]*\$\$x\^2\$\$", document.partition("<body>")[2])


def said(document):
    items = re.search(r'<ul id="said">(.*?)</ul>', document)[1]
    return [line.partition(" ")[::2] for line in re.findall(r"<li>(.*?)</li>", items)]


@pytest.mark.parametrize("width", [1200, 500])
def test_the_controls_do_what_they_say(width, cases, visit):
    diagnosis = cases.named()
    document, console = visit(with_script(render_report(diagnosis), VISIT), width)
    assert console == []
    told = said(document)
    assert [value for name, value in told if name == "shown"] == ["loop-0", "loop-3"]
    answers = dict(told)
    number, one = r"(-?[\d.e-]+)", diagnosis.comparisons[0]
    share, *gaps = (float(v) for v in re.fullmatch(
        rf" ?before share of the period: {number} measured − predicted \(N\): {number} ?; ?after share of the period: "
        rf"[\d.]+ measured − predicted \(N\): {number} ?", answers["difference"]).groups())
    place = round(share * cases.SAMPLES)
    assert gaps == pytest.approx([one.force[place] - values[place] for values in (one.before_force, one.after_force)],
                                 abs=1e-3)
    row, share, value = re.fullmatch(rf" ?(.*) share of the period: {number} \(measured − predicted\) / standard "
                                     rf"deviation: {number} ?", answers["map"]).groups()
    one = diagnosis.residual_maps[0]
    near = one.before[one.rows.index(row), int(float(share) * cases.SAMPLES) + np.array([-1, 0, 1])]
    assert np.min(np.abs(near - float(value))) < 1e-3
    assert {value for name, value in told if name == "saved"} == {"image/svg+xml, true", "image/png, true"}
    assert answers["before"] == "false"
    assert answers["after"] == "true"
    assert answers["rows"] == f"9 {len(diagnosis.ranking) + 1}"  # what the catalogue lacks is the last
    assert answers["wide"] == "true", "the page is no wider than the window"


@pytest.mark.parametrize(("flaw", "message"), [
    ("throw new Error('a flaw')", "Uncaught Error: a flaw"),
    ("Promise.reject(new Error('a refusal'))", "a refusal"),
    ("new Image().src = 'https://example.org/a.png'", "Content Security Policy"),
    ("eval('1')", "unsafe-eval"),
])
def test_a_flaw_would_be_seen(flaw, message, cases, visit):
    _, console = visit(with_script(render_report(cases.empty()), flaw))
    assert any(message in line for line in console)


def test_a_script_that_is_not_the_pages_own_does_not_run(cases, visit):
    text = render_report(cases.empty()).replace("</body>", "<script>document.title = 'taken'</script></body>")
    document, console = visit(text)
    assert "<title>taken" not in document
    assert any("Content Security Policy" in line for line in console)
