"""Design files: the shipped ones, the two ways to write a weight, and mistakes in one clear line."""

import dataclasses

import pytest

from firmware_model.errors import ConfigError
from gustproof.design.designs import Weight, list_designs, load_design

GOOD = {
    "description": '"one of my own"',
    "leak": "0.05",
    "W_d": "[0.65, 0.65, 0.3]",
    "W_n": "{ low = [0.01, 0.01, 0.01], high = [0.004, 0.004, 0.004], corner = 0.1 }",
    "W_e": "[1.0, 1.0, 1.0]",
    "W_u": "[0.3, 0.3, 0.3]",
}


def written(folder, **changes):
    path = folder / "mine.toml"
    entries = {**GOOD, **changes}
    path.write_text("".join(f"{key} = {value}\n" for key, value in entries.items() if value), encoding="utf-8")
    return path


def test_the_catalogue_is_the_files():
    assert list_designs() == ("D1", "D1-noise", "D2", "D5", "R1", "aided", "reference")
    assert all(load_design(name).name == name for name in list_designs())


def test_no_two_designs_make_the_same_law():
    laws = [load_design(name).law for name in list_designs()]
    assert len(set(laws)) == len(laws)


def test_a_list_is_a_constant_weight_and_a_table_a_first_order_one(tmp_path):
    design = load_design(written(tmp_path))
    assert design.name == "mine"
    assert design.W_d.system().order == 0
    assert design.W_n.system().order == 3


def test_a_design_can_be_changed_in_code():
    changed = dataclasses.replace(load_design("D1"), gamma=0.3, W_e=Weight(low=(2.0,) * 3, high=(1.0,) * 3, corner=5.0))
    assert changed.gamma == 0.3
    assert changed.W_e.system().order == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"leek": "0.05"}, r"mine\.toml: line \d+, leek: unknown key.*did you mean .leak.\?"),
        ({"leak": ""}, r"mine\.toml: leak: missing"),
        ({"leak": "0.0"}, "leak: input should be greater than 0"),
        ({"W_d": "[0.65, 0.65]"}, r"W_d\.low"),
        ({"W_n": "{ low = [1.0, 1.0, 1.0], corner = 1.0 }"}, r"W_n\.high: missing"),
        ({"backoff": "1.0"}, "backoff: input should be greater than 1"),
        ({"gamma": "nan"}, "gamma"),
        ({"W_l": "[0.1, 0.1, 0.1]"}, "W_l"),
        ({"W_m": "[0.1, 0.1, -0.1]"}, r"W_m\.2: input should be greater than or equal to 0"),
        ({"W_m": "[0.1, 0.1, 0.1]", "rate_loop_lag": "0.1"}, "W_m weights the moment of a law that commands torque"),
    ],
)
def test_a_mistake_is_one_clear_line(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message) as raised:
        load_design(written(tmp_path, **changes))
    assert "\n" not in str(raised.value)


def test_an_unknown_name_has_the_nearest_known_one():
    with pytest.raises(ConfigError, match=r"no design named 'D9'.*did you mean 'D"):
        load_design("D9")
