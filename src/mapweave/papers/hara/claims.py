"""What the paper claims, where each claim stands in the code, the test that holds it, and how it is judged."""

from ...sim.corridor import CorridorConfig
from ..reproduction import Claim
from ..verdicts import Check, question, rule

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
        rule(Check("odometry", "ATE [m], each drive, beyond the corridor's width", least=CorridorConfig().width)),
    ),
    Claim(
        "Intensity-ICP is better than odometry (Fig. 5)",
        "laser/icp_slam.py",
        f"{STATEMENTS}::test_intensity_icp_errs_half_of_odometry_at_most_and_less_than_icp_on_geometry",
        "drawn",
        "icp",
        "{drives} drives",
        COMMAND,
        rule(Check("icp", "ATE / odometry's, each drive", most=0.5)),
    ),
    Claim(
        "Matching fails on the way and the map turns away; the gate refuses it and carries the map (Figs. 5, 6)",
        "papers/hara/gate.py",
        f"{LOOP}::test_where_matching_fails_the_gate_carries_the_map_and_refuses_rightly",
        "drawn",
        "gate",
        "{drives} drives",
        COMMAND,
        rule(
            Check("gate_fails", "ATE without the gate, widest pairs / narrowest", least=2.0),
            Check("gate_saves", "ATE with the gate / without, widest pairs", most=0.75),
            Check("gate_right", "share of refusals that are right", least=0.95),
        ),
    ),
    Claim(
        "The particle filter closes the loop where one hypothesis cannot (Fig. 7), as printed",
        "papers/hara/methods.py",
        f"{STATEMENTS}::test_the_printed_filter_does_not_close_the_loop_where_matching_alone_does_not",
        "drawn",
        "printed",
        "{drives} drives",
        COMMAND,
        rule(Check("printed", "ATE / Intensity-ICP's, each drive", most=0.9)),
    ),
    Claim(
        "The same, our filter with calibrated intensity",
        "laser/particle_slam.py",
        f"{STATEMENTS}::test_our_filter_with_intensity_errs_a_fraction_of_geometry_and_of_odometry",
        "drawn",
        "ours",
        "{drives} drives",
        COMMAND,
        rule(Check("ours", "ATE / Intensity-ICP's, each drive", most=0.9)),
    ),
    Claim(
        "Intensity tells places apart where geometry does not",
        "papers/hara/light_edges.py",
        f"{STATEMENTS}::test_intensity_errs_a_seventh_of_the_best_geometry_and_of_the_least_that_geometry_can",
        "not measured",
        "geometry",
        "{drives} drives",
        COMMAND,
        rule(
            Check("geometry", "ATE / best geometry's", most=0.15),
            Check("geometry_bound", "root mean square / the least that geometry can", most=0.15),
        ),
    ),
    Claim(
        "Future work: the best weight of intensity",
        "papers/hara/alpha.py",
        f"{LOOP}::test_the_weight_of_intensity_is_found_from_the_log",
        "by experience",
        "alpha",
        "{drives} drives",
        COMMAND,
        question(Check("alpha", "ATE at the alpha found / at the best tried", most=1.25)),
    ),
    Claim(
        "Future work: light as a feature that range and angle leave alone",
        "laser/beam.py",
        f"{STATEMENTS}::test_the_feature_found_from_the_log_is_the_reflectance_and_maps_as_well_as_the_true_law",
        "not tried",
        "feature",
        "{drives} drives",
        COMMAND,
        question(Check("feature", "ATE of our filter / of the paper's", most=0.5)),
    ),
    Claim(
        "Future work: localisation with intensity in a finished map",
        "papers/hara/starts.py",
        f"{LOOP}::test_no_trusted_start_is_wrong_and_light_tells_what_walls_cannot",
        "not tried",
        "localised",
        "{starts} starts with light, {bare_starts} with geometry alone, which knows no twins",
        COMMAND,
        question(
            Check("starts_wrong", "wrong, with light and without", most=0.0),
            Check("starts_right", "share of starts in the building that light finds", least=0.75),
        ),
    ),
)
