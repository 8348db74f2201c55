"""The page in a real browser: no console error, every figure drawn, nothing wider than a phone."""

import json
import re
import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from studies.made_up import made_up

from scso_nlp.emg import Emg, EmgMap, MotionResult, MuscleGroup, compare
from scso_nlp.report.page import write_report
from scso_nlp.studies import write_cohort

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs Chromium or Chrome; none is installed")

#: The page runs no script itself, so one around it measures, in a frame as wide as the screen.
AROUND = """<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,"><title>measuring</title>
<iframe src="report.html" style="width: WIDTHpx; height: 800px; border: 0"></iframe>
<pre></pre>
<script>
onload = async () => {
  const inside = document.querySelector("iframe").contentDocument;
  const images = [...inside.images];
  const texts = [...inside.querySelectorAll("p, td")];
  await Promise.all(images.map((image) => image.decode().catch(() => {})));
  document.querySelector("pre").textContent = JSON.stringify({
    width: inside.documentElement.scrollWidth,
    images: images.length,
    broken: images.filter((image) => !image.naturalWidth).length,
    heading: inside.querySelector("h1").textContent,
    smallest: Math.min(...texts.map((text) => parseFloat(getComputedStyle(text).fontSize))),
  });
};
</script>
"""


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def of_a_motion(folder):
    """Write a report of a long motion with EMG and an awkward group name."""
    time = np.linspace(0.0, 2.0, 41)
    wave = 0.3 + 0.1 * np.sin(3 * time)
    results = [
        MotionResult(
            label=label, name="lift", time=time, muscles=("erector_spinae_right", "rectus"),
            activation=np.column_stack([wave, share * wave]), is_solved=np.ones(41, dtype=bool),
            report={"settings": {"q": 5.0}, "inputs_sha256": {"model.osim": "ab" * 32}},
        )
        for label, share in (("SO", 0.0), ("SCSO q = 5", 0.2), ("SCSO q = 3", 0.4))
    ]  # fmt: skip
    groups = (
        MuscleGroup(name="erector spinae, right <&>", muscles=("erector_spinae_right",), channels=("es",)),
        MuscleGroup(name="rectus abdominis", muscles=("rectus",)),
    )
    emg = Emg(channels=("es",), time=time, values=(wave + 0.05)[:, None])
    write_report(compare(results, emg=emg, emg_map=EmgMap(groups=groups)), folder / "report.html")


def of_a_study(folder):
    """Write the page of a study with long names."""
    write_cohort(made_up(folder), folder / "report.html")


@pytest.fixture(params=[of_a_motion, of_a_study], ids=lambda write: write.__name__)
def page(request, tmp_path):
    """Address of a folder that holds a page."""
    request.param(tmp_path)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield tmp_path, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def visit(folder, address, page):
    """Write a page, open it, and give its elements and what the console said."""
    (folder / "around.html").write_text(page, encoding="utf-8")
    options = (
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        "--enable-logging=stderr", "--window-size=1400,1000", "--virtual-time-budget=10000", "--dump-dom",
    )  # fmt: skip
    command = [BROWSER, *options, f"--user-data-dir={folder / 'profile'}", f"{address}/around.html"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("width", [1200, 390])
def test_the_report_fits_the_screen_and_the_console_stays_empty(page, width):
    elements, console = visit(*page, AROUND.replace("WIDTH", str(width)))
    found = json.loads(re.search(r"<pre>(\{.*?\})</pre>", elements, flags=re.S).group(1))
    assert found["heading"] == "lift"
    assert found["width"] <= width
    assert found["images"] >= 2
    assert found["broken"] == 0
    # smaller print cannot be read on a phone
    assert found["smallest"] >= 12
    assert console == []


def test_what_the_console_says_would_be_seen(page):
    _, console = visit(*page, "<!DOCTYPE html><script>console.error('a')</script>")
    assert len(console) == 1
