"""What results depend on, in twelve digits."""

from pathlib import Path

from irl_dal.storage.fingerprint import fingerprint


def test_it_changes_with_texts_files_and_sources_below_folders(tmp_path: Path) -> None:
    """And with nothing else."""
    package = tmp_path / "package"
    (package / "inner").mkdir(parents=True)
    source, weights = package / "inner" / "car.urdf", tmp_path / "weights.bin"
    source.write_text("<robot/>")
    weights.write_bytes(b"\0\1")

    def now(text: str = "settings") -> str:
        return fingerprint(text, package, weights)

    first = now()
    assert len(first) == 12 and int(first, 16) >= 0
    (package / "notes.txt").write_text("not a source")
    assert now() == first != now("other settings")
    source.write_text("<robot name='car'/>")
    second = now()
    weights.write_bytes(b"\0\2")
    assert len({first, second, now()}) == 3
