"""What the paper claims, where each claim stands in the code, and the test that holds it."""

from ..reproduction import Claim

COMMAND = "reproduce hara"
LOOP = "papers/test_reproduce_hara.py"
STATEMENTS = "papers/test_hara_statements.py"

CLAIMS = (
    Claim(
        "Odometry alone bends the map (Fig. 4)",
        "sim/drift.py",
        f"{LOOP}::test_every_method_of_the_paper_is_compared_and_drawn",
        "20 m at the end",
        "odometry",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "Intensity-ICP is better than odometry (Fig. 5)",
        "laser/icp_slam.py",
        f"{STATEMENTS}::test_intensity_icp_errs_less_than_icp_on_geometry",
        "drawn",
        "icp",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "Matching fails on the way and the map turns away; the gate refuses it and carries the map (Figs. 5, 6)",
        "papers/hara/gate.py",
        f"{LOOP}::test_where_matching_fails_the_gate_carries_the_map_and_refuses_rightly",
        "drawn",
        "gate",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "The particle filter closes the loop where one hypothesis cannot (Fig. 7), as printed",
        "papers/hara/methods.py",
        f"{LOOP}::test_every_method_of_the_paper_is_compared_and_drawn",
        "drawn",
        "printed",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "The same, our filter with calibrated intensity",
        "laser/particle_slam.py",
        f"{STATEMENTS}::test_our_filter_with_intensity_errs_a_fraction_of_geometry_and_of_odometry",
        "drawn",
        "ours",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "Intensity tells places apart where geometry does not",
        "papers/hara/light_edges.py",
        f"{STATEMENTS}::test_intensity_errs_a_seventh_of_the_best_geometry_and_of_the_least_that_geometry_can",
        "not measured",
        "geometry",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "Future work: the best weight of intensity",
        "papers/hara/alpha.py",
        f"{LOOP}::test_the_weight_of_intensity_is_found_from_the_log",
        "by experience",
        "alpha",
        "{drives} drives",
        COMMAND,
    ),
    Claim(
        "Future work: localisation with intensity in a finished map",
        "papers/hara/starts.py",
        f"{LOOP}::test_no_trusted_start_is_wrong_and_light_tells_what_walls_cannot",
        "not tried",
        "localised",
        "{starts} starts",
        COMMAND,
    ),
)
