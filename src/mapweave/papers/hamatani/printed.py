"""The figures that Hamatani, Nakamura and Naruse print in their Tables 1, 2 and 3."""

PRINTED: dict[int, dict[tuple[float, float], float]] = {  # by table: (variance of guess, of bearings) -> error
    1: {
        (0, 0.01): 6.6921,
        (0, 25): 5.1771,
        (0.01, 0.01): 0.4659,
        (0.01, 25): 5.3481,
        (25, 0.01): 1.2714,
        (25, 25): 2.387,
    },
    2: {
        (0, 0.01): 0.0078,
        (0, 25): 0.3793,
        (0.01, 0.01): 0.0071,
        (0.01, 25): 0.3137,
        (25, 0.01): 0.0293,
        (25, 25): 0.3913,
    },
    3: {
        (0, 0.01): 0.0016,
        (0, 25): 0.0794,
        (0.01, 0.01): 0.0012,
        (0.01, 25): 0.0531,
        (25, 0.01): 0.0105,
        (25, 25): 0.0786,
    },
}
WITHIN = {1: 2.0, 2: 1.3, 3: 2.0}  # by table: the factor up to which a cell counts as reproduced
