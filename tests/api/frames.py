"""What stands for a table that a program holds."""


class Frame:
    """As much of a data frame as is asked for."""

    def __init__(self, columns):
        self.columns = list(columns)
        self._data = columns

    def __getitem__(self, name):
        return self._data[name]
