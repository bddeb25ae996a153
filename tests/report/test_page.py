"""report.html: whole, well formed, the same for the same run, and about nothing but the run."""

import hashlib
import re
import shutil
from dataclasses import replace

import pytest
from helpers.problems import PENDULUM
from html5lib import HTMLParser

from necc_casadi import load_model, run
from necc_casadi.report.gallery import figures_of
from necc_casadi.report.mathml import row
from necc_casadi.report.page import report


@pytest.fixture(scope="module")
def result():
    return run(PENDULUM, "pi/4", compare=True)


@pytest.fixture(scope="module")
def page(result) -> str:
    return report(result.findings, figures_of(result.findings), result.request.command)


def tree(page):
    return HTMLParser(strict=True, namespaceHTMLElements=False).parse(page)


def test_the_page_is_well_formed(page):
    root = tree(page)
    assert root.find("head/title").text == "Pendulum: certified, asymptotically stable"
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids)) > 10
    for name in re.findall(r'(?:href="|url\()#([^")]+)', page):
        assert name in ids


def test_the_page_asks_nothing_of_a_network(page):
    """Nothing but data in it and fragments of it is referred to; a script there is none."""
    assert "<script" not in page
    for name in re.findall(r'(?:src|href|data|action)="([^"]*)"', page):
        assert name.startswith(("#", "data:")), name[:60]
    assert not re.search(r"url\((?!#)", page)
    assert "@import" not in page
    urls = set(re.findall(r'https?://[^\s"<]+', page))
    assert urls == {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_the_page_says_what_the_run_found(page, result):
    root = tree(page)
    text = " ".join("".join(root.itertext()).split())
    for claim in result.claims:
        assert " ".join(claim.statement.split()) in text
    assert result.design.hash in text
    assert hashlib.sha256(result.certificate.to_json().encode()).hexdigest() in text
    for name, version in result.design.versions.items():
        assert f"{name} {version}" in text
    assert "necc_casadi.run('pendulum.py', target='pi/4', compare=True)" in text
    assert "phase margin" in text
    for note in result.notes:
        assert note in text
    titles = [title.text for title in root.iter("h2")]
    assert titles == [
        "Model", "Verdict and method", "Design", "What is proved", "How it responds",
        "Beside LQR and the optimum", "Figures", "Limits", "Made with",
    ]  # fmt: skip
    assert len(list(root.iter("figure"))) == len(figures_of(result.findings))


def test_the_same_run_gives_the_same_page(page, tmp_path):
    """In another folder, on another day: neither place nor time stands in it."""
    (tmp_path / "pendulum.py").write_bytes(PENDULUM.read_bytes())
    again = run(tmp_path / "pendulum.py", "pi/4", compare=True, out=tmp_path / "out")
    assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8") == page
    assert "report.html" in again.to_dict()["files"]


def test_a_name_is_no_markup(result):
    plant = replace(result.findings.system, name="<b>&\"'</b>", units={"q": "<i>"})
    made = replace(result.design, loop=replace(result.design.loop, plant=plant))
    hostile = replace(result.findings, system=plant, design=made)
    page = report(hostile, figures_of(hostile), '"><script>x</script>')
    root = tree(page)
    assert not list(root.iter("script"))
    assert not list(root.iter("i"))
    assert root.find("body/h1").text == "<b>&\"'</b>"


def test_parameters_stay_letters_in_the_mathematics():
    maglev = load_model(PENDULUM.parent / "maglev.py")
    assert "<mi>g</mi>" in row(maglev.parametric.H)
    assert maglev.parametric.at(maglev.parametric.values).H == maglev.loop.plant.H


CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome")
                 if (found := shutil.which(name))), None)  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="NO BROWSER: chromium is not installed, nobody looked")
@pytest.mark.parametrize("width", [400, 1400])
def test_a_browser_shows_it_without_complaint(page, tmp_path, width):
    """No error, no request, nothing beside the window, every formula typeset, a print to pages."""
    from playwright.sync_api import sync_playwright

    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    place = (tmp_path / "report.html").as_uri()
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        window = browser.new_page(viewport={"width": width, "height": 900})
        said, asked = [], []
        window.on("console", lambda message: said.append(message.text))
        window.on("pageerror", lambda problem: said.append(str(problem)))
        window.on("request", lambda request: asked.append(request.url))
        window.goto(place)
        assert window.evaluate("document.documentElement.scrollWidth") <= width
        assert window.evaluate("document.querySelectorAll('figure svg').length") >= 4
        heights = window.evaluate(
            "[...document.querySelectorAll('math, figure svg')]"
            ".map(e => e.getBoundingClientRect().height)"
        )
        assert min(heights) > 10
        assert window.pdf(format="A4").startswith(b"%PDF")
        browser.close()
    assert said == []
    assert {url for url in asked if not url.startswith("data:")} == {place}
