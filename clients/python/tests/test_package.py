"""The package itself: types, the wheel, the reference."""

from __future__ import annotations

import ast
import subprocess
import sys
import zipfile
from pathlib import Path

import mom
import mom.device
import mom.drive

HERE = Path(__file__).parents[1]


def run(*args: str, **options: object) -> None:
    done = subprocess.run([sys.executable, *args], cwd=HERE, capture_output=True, text=True, **options)  # type: ignore
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_types_are_strict(tmp_path: Path) -> None:
    run("-m", "mypy", "--cache-dir", str(tmp_path))


def test_the_wheel_has_all_of_it_and_its_types(tmp_path: Path) -> None:
    run("-m", "build", "--no-isolation", "--wheel", "--outdir", str(tmp_path))
    (wheel,) = tmp_path.glob("mom_client-*-py3-none-any.whl")
    names = zipfile.ZipFile(wheel).namelist()
    sources = HERE / "src"
    wanted = {str(file.relative_to(sources)) for file in (sources / "mom").rglob("*.py")} | {"mom/py.typed"}
    assert wanted <= set(names) and not [name for name in names if "test" in name]


def test_the_reference_is_made_of_the_comments(tmp_path: Path) -> None:
    run("-m", "pdoc", "mom", "-o", str(tmp_path), env={"PYTHONPATH": "src", "PATH": "/usr/bin:/bin"})
    assert "Exclusive control of what a token guards" in (tmp_path / "mom.html").read_text()
    assert "Makes a method a verb" in (tmp_path / "mom/device.html").read_text()
    assert "A device that is driven under a token" in (tmp_path / "mom/drive.html").read_text()


def test_all_that_is_public_is_described() -> None:
    for module in (mom, mom.device, mom.drive):
        for name in module.__all__:
            value = getattr(module, name)
            if isinstance(value, type) or name in ("connect", "driving", "lost_words", "verb"):
                assert (value.__doc__ or "").strip(), name


def test_it_is_python_3_9() -> None:
    for file in (HERE / "src/mom").rglob("*.py"):
        ast.parse(file.read_text(), feature_version=(3, 9))
