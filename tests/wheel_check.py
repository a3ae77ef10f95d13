"""Install the wheel that the sdist makes, and use it beside foreign modules: ``python -m tests.wheel_check``.

The main job runs outside the checkout, in a folder (also on PYTHONPATH) with modules named as ours once were; each raises.
Exit status 1 with one sentence if the wheel puts another name at the top of site-packages, if it does not say that a package
is typed, if the parts of a report are missing, if a link of its description or of a page in the sdist leads nowhere, or if a
command fails.
"""

import json
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from tests.pages import PAGES, parse_page, read_page

ROOT = Path(__file__).resolve().parent.parent
#: All that the wheel may put beside everybody's modules.
TOP = {"cachesim", "cli.py", "nptrace", "nptrace_base", "rtrace", "traces"}
FOREIGN = ("jit", "options", "compiling", "precompile", "errors", "tables", "atomic")
JOB = (
    ("nptrace", "--version"),
    ("nptrace", "render", "sponza", "bunny", "--name", "sponza", "--name", "bunny", "--offline", "--pixels", "48x48"),
    ("npcache", "replay", "--size", "8K,16K", "--assoc", "1,2", "--json"),
    ("npcache", "table1"),
    ("nptrace", "export", "traces/sponza-bvh"),
    ("npcache", "sweep", "sponza-bvh.din", "--size", "1K..8K"),
)


def main() -> None:
    """Build, install, look, run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
        (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
        check_pages(sdist, wheel)
        files = set(zipfile.ZipFile(wheel).namelist())
        strangers = {path.split("/")[0] for path in files} - TOP
        strangers = {name for name in strangers if not name.endswith(".dist-info")}
        if strangers:
            raise SystemExit(f"the wheel puts {', '.join(sorted(strangers))} at the top of site-packages; it may hold {TOP}")
        untyped = {name for name in TOP - {"cli.py"} if f"{name}/py.typed" not in files}
        if untyped:
            raise SystemExit(f"the wheel has no py.typed in {', '.join(sorted(untyped))}")
        pages = {f"cachesim/report/page.{ending}" for ending in ("html", "css", "js")}
        if pages - files:
            raise SystemExit(f"the wheel lacks {', '.join(sorted(pages - files))}, of which npcache report makes its page")
        run(sys.executable, "-m", "venv", folder / "env", cwd=folder)
        python = folder / "env" / "bin" / "python"
        run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel, cwd=folder)
        work = folder / "work"
        work.mkdir()
        for module in FOREIGN:
            (work / f"{module}.py").write_text(
                f'raise ImportError("the foreign {module}.py was imported")\n', encoding="utf-8"
            )
        environment = {"XDG_CACHE_HOME": str(folder / "cache"), **os.environ, "PYTHONPATH": str(work), "HOME": str(folder)}
        printed = [run(python.with_name(words[0]), *words[1:], cwd=work, env=environment) for words in JOB]
        counted = json.loads(printed[2])
        print(f"{wheel.name}: {len(JOB)} commands ran outside the checkout, {len(counted)} results")


def check_pages(sdist: Path, wheel: Path) -> None:
    """SystemExit if a link of a page in the sdist, or of the wheel's description, leads nowhere."""
    with tarfile.open(sdist) as files:
        held = {name.partition("/")[2] for name in files.getnames()}
    lost = {str(page.relative_to(ROOT)) for page in PAGES} - held
    for page in PAGES:
        targets = {(page.parent / link.partition("#")[0]).resolve() for link, _ in read_page(page).links if ":" not in link}
        lost |= {str(target.relative_to(ROOT)) for target in targets} - held
    if lost:
        raise SystemExit(f"pages lead to {', '.join(sorted(lost))}, which the sdist does not hold")
    with zipfile.ZipFile(wheel) as files:
        (about,) = (files.read(name).decode() for name in files.namelist() if name.endswith("METADATA"))
    description = about.partition("\n\n")[2]
    links = [link for link, _ in parse_page(description).links if not link.startswith("https:")]
    if links or len(description) < 1000:
        raise SystemExit(f"the wheel's description of {len(description)} characters has the relative links {links}")


def run(*words: object, cwd: Path, env: dict[str, str] | None = None) -> str:
    """Run a command and return its output; SystemExit with what it printed if it fails."""
    done = subprocess.run([str(word) for word in words], cwd=cwd, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
