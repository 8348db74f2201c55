"""What belongs to a release: one version everywhere, a citation, a shell that knows the commands."""

import os
import re
import subprocess
import sys
import tomllib

from conftest import PROJECT_ROOT

from scso_nlp.versions import version_of, versions

VERSION = tomllib.loads((PROJECT_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def printed(*arguments, **environment):
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    return done.stdout


def first(pattern, name):
    return re.search(pattern, (PROJECT_ROOT / name).read_text(encoding="utf-8"), flags=re.M)[1]


def test_the_version_is_the_same_everywhere():
    assert first(r"^version: (\S+)$", "CITATION.cff") == VERSION
    assert first(r"^## (\d\S*?),? ", "CHANGELOG.md") == VERSION


def test_the_version_is_printed_first_by_the_package_run_as_a_module():
    lines = printed("-m", "scso_nlp", "--version").splitlines()
    assert lines[0] == f"scso_nlp {version_of('scso_nlp')}"
    assert lines[1] == f"python {sys.version.split()[0]}"


def test_what_is_not_installed_has_no_version():
    assert version_of("no_such_package_of_anybody") is None
    assert set(versions()) == {"scso_nlp", "python", "casadi", "numpy", "scipy", "opensim"}


def test_a_shell_completes_commands():
    found = printed("-m", "scso_nlp", _SCSO_COMPLETE="complete_bash", COMP_WORDS="scso re", COMP_CWORD="1")
    assert set(found.split()) == {"report", "reach"}


def test_the_citation_names_the_papers_doi():
    assert first(r"^    doi: (\S+)$", "CITATION.cff") == "10.1016/j.jbiomech.2019.05.007"
