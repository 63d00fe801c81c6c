"""Paths are written and read back, and what is no path in metres over seconds is refused."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.errors import SsacError
from ssac.network.tum import Path, read_path, write_path

TIMES_S = 1.7e9 + np.arange(50) * 0.2  # as of a receiver that counts from 1970


def _path(with_deviations=True):
    rng = np.random.default_rng(0)
    positions = np.cumsum(rng.normal(size=(50, 3)), axis=0) + 30.0
    return Path(TIMES_S, positions, rng.uniform(0.01, 0.1, (50, 3)) if with_deviations else None)


@pytest.mark.parametrize("name", ["path.tum", "path.csv"])
@pytest.mark.parametrize("with_deviations", [True, False])
def test_a_path_survives_writing(tmp_path, name, with_deviations):
    file, path = tmp_path / name, _path(with_deviations)
    write_path(file, path)
    again = read_path(file)
    np.testing.assert_allclose(again.times_s, path.times_s, rtol=0.0, atol=3e-7)  # 7 digits, 1970
    np.testing.assert_allclose(again.positions_m, path.positions_m, rtol=1e-8)  # 9 digits
    assert (again.deviations_m is not None) == (with_deviations and name.endswith("csv"))
    if again.deviations_m is not None:
        np.testing.assert_allclose(again.deviations_m, path.deviations_m, rtol=1e-8)
    if name.endswith("tum"):
        assert again.quaternions is None
        rows = [line.split(" ") for line in file.read_text().splitlines()]
        assert {(len(row), *row[4:]) for row in rows} == {(8, "0", "0", "0", "1")}
        turned = np.tile([0.0, 0.6, 0.0, 0.8], (50, 1))
        write_path(file, replace(path, quaternions=turned))
        np.testing.assert_array_equal(read_path(file).quaternions, turned)


@pytest.mark.parametrize(
    "text",
    [
        "# t x y z\n0 1 2 3 0 0 0 1\n0.5 2 2 4 0 0 0 1\n",
        "0 1 2 3\n0.5 2 2 4\n",
        "t_s,x_m,y_m,z_m\n0,1,2,3\n0.5,2,2,4\n",
        "\ufefffix, z, y, t, x\r\n1, 3, 2, 0, 1\r\n\r\n1, 4, 2, 0.5, 2\r\n",
        "1 2 3\n2 2 4\n",  # which is read where no times are needed
    ],
)
def test_forms_that_are_read(tmp_path, text):
    has_times = not text.startswith("1 2 3")
    (tmp_path / "path").write_text(text, encoding="utf-8")
    path = read_path(tmp_path / "path", needs_times=has_times)
    assert path.has_times == has_times
    if has_times:
        np.testing.assert_array_equal(path.times_s, [0.0, 0.5])
    np.testing.assert_array_equal(path.positions_m, [[1.0, 2.0, 3.0], [2.0, 2.0, 4.0]])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1 2 3\n2 2 4\n", "needs times"),
        ("x_m,y_m,z_m\n2,2,4\n", "needs times"),
        ("", "no points"),
        ("t_s,x_m,y_m,z_m\n", "no points"),
        ("0 1 2 3\n1 2 nan 4\n", "point 1 has a value that is no finite number"),
        ("1 1 2 3\n0 2 2 4\n", "time order, but point 1"),
        ("0 1 2 3\n0 2 2 4\n", "time order, but point 1"),
        ("0 1 2 3\n1 2 two 4\n", "must be 4 numbers, but point 1 is '1 2 two 4'"),
        ("0 1 2 3\n1 2 4\n", "must be 4 numbers, but point 1 is '1 2 4'"),
        ("0 1 2 3 4\n1 2 4 4 5\n", "got 5 numbers"),
        ("t_s,lat,lon,alt_m\n0,47.1,8.2,400\n", "latitude and longitude"),
        ("0 47.1 8.2 400\n1 47.1001 8.2001 420\n", "as of degrees"),
        ("t_s,east,north,up\n0,1,2,3\n", "must name the columns"),
        ("0 1 2 3\n200000 1 2 4\n", "give seconds"),
        ("0 1 2 3 0 0 0 1\n1 1 2 4 0 0 0 0\n", "quaternion is zero"),
        (b"\x89PNG\xff\xfe\x00", "not a text file"),
    ],
)
def test_what_is_no_path_is_refused_in_one_line(tmp_path, text, reason):
    (tmp_path / "path").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SsacError, match=reason) as raised:
        read_path(tmp_path / "path")
    assert str(raised.value).startswith(str(tmp_path / "path"))
    assert "\n" not in str(raised.value)
