"""How shapes and types are checked while tests run: an int may stand where a float is asked for, as PEP 484 says."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
