"""Print the folder of the torch and torchvision that this Python has; exit code 1 where they are missing or too old."""

import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path


def main() -> int:
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    (needed,) = (line.partition(">=")[2] for line in project["dependencies"] if line.startswith("torch>="))
    try:
        torch = distribution("torch")
        distribution("torchvision")
    except PackageNotFoundError:
        return 1
    if numbers(torch.version) < numbers(needed):
        return 1
    print(Path(str(torch.locate_file(""))).resolve())
    return 0


def numbers(version: str) -> tuple[int, ...]:
    """Major and minor number of a version such as 2.14.0+cu132."""
    return tuple(int(part) for part in version.split("+")[0].split(".")[:2])


if __name__ == "__main__":
    sys.exit(main())
