import pytest

from firmware_model.mavlink.services.service import Service, Stream, merge_services


def test_services_combine_their_tables():
    one, two = (
        Service(streams={1: Stream(lambda: None)}),
        Service(streams={2: Stream(lambda: None)}, on_request={3: list}),
    )
    both = merge_services([one, two])
    assert (set(both.streams), set(both.on_request)) == ({1, 2}, {3})


def test_a_number_in_two_services_is_a_mistake():
    with pytest.raises(ValueError, match="number 7"):
        merge_services([Service(requests={7: print}), Service(requests={7: print, 8: print})])
