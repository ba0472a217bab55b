"""Vehicle files that come with Alula, and where they lie."""

from pathlib import Path

FOLDER = Path(__file__).parent


def vehicle_path(given: str | Path) -> Path:
    """The vehicle file that is meant: a path, or the name of a file that comes with Alula, such as "arpl_250g"."""
    bundled = FOLDER / f"{given}.toml"
    return bundled if Path(given).name == str(given) and bundled.exists() and not Path(given).exists() else Path(given)
