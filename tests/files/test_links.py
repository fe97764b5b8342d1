"""Links out of a folder are found, whatever on the way is one."""

from pathlib import Path

from wayloom.files.links import leading_out


def test_a_link_that_leads_out_is_found_and_one_inside_is_not(tmp_path: Path) -> None:
    (tmp_path / "log" / "images").mkdir(parents=True)
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "log" / "images" / "a").write_text("a")
    (tmp_path / "log" / "inside").symlink_to("images/a")
    (tmp_path / "log" / "outside").symlink_to(tmp_path / "secret")
    (tmp_path / "log" / "twice").symlink_to("outside")
    (tmp_path / "log" / "broken").symlink_to(tmp_path / "log" / "nothing")
    files = [tmp_path / "log" / name for name in ("images/a", "inside", "outside", "twice", "broken")]
    assert [path.name for path in leading_out(files, tmp_path / "log")] == ["outside", "twice"]


def test_a_file_behind_a_linked_folder_leads_out_and_a_folder_reached_by_a_link_does_not(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a").write_text("a")
    (tmp_path / "log" / "folder").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "link").symlink_to(tmp_path / "log")
    (tmp_path / "log" / "b").write_text("b")
    files = [tmp_path / "link" / "folder" / "a", tmp_path / "link" / "b"]
    assert list(leading_out(files, tmp_path / "link")) == files[:1]
