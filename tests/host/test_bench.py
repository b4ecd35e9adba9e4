"""What every bench shares: results are kept by a key."""

import pytest

from noctule import bench


def test_what_was_measured_is_kept_until_its_key_changes(tmp_path):
    path, asked = tmp_path / "part" / "one.json", []

    def measure():
        asked.append(len(asked))
        return {"value": len(asked)}

    assert bench.kept(path, "a", False, measure) == {"key": "a", "value": 1}
    assert bench.kept(path, "a", False, measure)["value"] == 1 and len(asked) == 1
    assert bench.kept(path, "b", False, measure)["value"] == 2       # another build
    assert bench.kept(path, "b", True, measure)["value"] == 3        # asked for anew

    def broken():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench.kept(path, "c", False, broken)
    assert bench.kept(path, "b", False, measure)["value"] == 3       # what was there is still there
    assert [p.name for p in path.parent.iterdir()] == ["one.json"]
