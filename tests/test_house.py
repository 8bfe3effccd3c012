"""The picture of the house in the documentation."""

from pathlib import Path

import house

import mapweave


def test_every_room_stands_on_it():
    rooms = {path.parent.name for path in Path(mapweave.__file__).parent.glob("*/__init__.py")}
    assert {*house.PLACE, *house.GROUND} == rooms
    assert all(files and doc for files, _, doc in house.rooms().values())


def test_rooms_import_from_rows_below_their_own_or_from_their_own():
    row = {room: y for room, (_, y) in house.PLACE.items()}
    assert [(a, b) for a, b in house.needed(house.imports()) if row[a] > row[b]] == []
