"""What is wrong with the data or the estimate is a value: a code with numbers; its words stand here, in one table.

`python -m mapweave.core.findings` prints the page of the documentation that is made of the table.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from .names import robot_key

Verdict = Literal["good", "doubtful", "bad"]
Severity = Literal["note", "doubtful", "bad"]
Value = float | str | Mapping[str, float | str] | None


class FindingKind(NamedTuple):
    """What findings of one code have in common.

    severity: what one of them makes of the verdict, `note` nothing; text: the sentence, with the finding's values in
    it; means: what is so where it is found; do: what a user can do.
    """

    severity: Severity
    text: str
    means: str
    do: str


SECTIONS: dict[str, dict[str, FindingKind]] = {
    "Places and segments": {
        "scan-gap": FindingKind(
            "note",
            "no scans for {value:.1f} s while the robot drove",
            "The scanner was silent while the robot drove. The trajectory is cut there: how the pieces lie is told by "
            "places that both saw.",
            "Nothing where places join the pieces; else `segment-apart` tells it. Look for lost messages.",
        ),
        "gap-disputed": FindingKind(
            "doubtful",
            "over a gap in the scans places put the robot {value:.1f} m from where the wheels do",
            "The scanner was silent while the robot drove, and what it saw afterwards looks like another place than "
            "the one that its wheels tell: the robot was carried, or several places look alike.",
            "Look at the map after that time; say in a decisions file which places are apart.",
        ),
        "cut-disputed": FindingKind(
            "doubtful",
            "places put the robot {value:.1f} m from where the wheels do, and nothing that it saw changed at once",
            "The motion was not sure there, as amid a wide hall, and what was seen afterwards looks like another place "
            "than the one that the wheels tell. A robot that was carried sees another scene at once: rather, several "
            "places look alike.",
            "Look at the map after that time; say in a decisions file which places are apart.",
        ),
        "track-cut": FindingKind(
            "note",
            "from one scan to the next the motion is not sure: {value}",
            "Scans and wheels leave open how the robot moved there. The trajectory is cut there: how the pieces lie is "
            "told by places that both saw, and where views only faded by the wheels.",
            "Nothing where places join the pieces; else `segment-apart` tells it.",
        ),
        "place-unclear": FindingKind(
            "doubtful",
            "what was seen afterwards fits at another place of the map about as well",
            "The trajectory was cut there, and the building looks alike in several places: the piece after it may "
            "lie at another one.",
            "Look at the map after that time; say in a decisions file which places are apart.",
        ),
        "walls-seen-through": FindingKind(
            "doubtful",
            "the robot saw through {value:.0f} % of the walls that it saw at other times, over widths no door has",
            "That is more than doors and people explain: places are laid on each other that are not one, or walls are "
            "bent: the robot was carried, a building looks alike in several places, or the scanner pitches, outdoors "
            "and over sills.",
            "Look for rooms that lie on each other in the map; give the parts of the log as logs of their own.",
        ),
        "walls-twice": FindingKind(
            "doubtful",
            "it and {other} saw through {value:.0f} % of each other's walls in their map, over widths no door has",
            "One of the two maps is bent, they were merged wrongly, or walls were moved between the drives: the map "
            "draws walls twice.",
            "Look at the two robots in the map; map them without each other, or say that they are apart (`edit`).",
        ),
        "glass-seen": FindingKind(
            "note",
            "{value:.1f} m of walls are seen where they are hit squarely and seen through at a slant, as glass is",
            "Glass returns light where a beam meets it squarely, and lets it through elsewhere. Where the robot never "
            "looked at a pane squarely the map does not know it.",
            "Nothing: such walls stay in the map, whatever went through them. Mask panes by hand where none were hit.",
        ),
        "segment-apart": FindingKind(
            "doubtful",
            "a piece of {value:.1f} m shares no place with what came before it",
            "The trajectory was cut, and nothing that was seen says how the piece lies: it stands where the wheels, or "
            "the last motion, put it. Each piece is right by itself.",
            "Drive through a known place, or give the pieces as logs of their own.",
        ),
        "scene-jump": FindingKind(
            "doubtful",
            "the scene changes at once: {now:.0f} % of the returns lie on walls seen before, of the last scan "
            "{before:.0f} %, while the wheels tell {way:.2f} m ({times:.0f} times in all)",
            "From one scan to the next the robot sees another place, though its wheels hardly moved: it was carried, "
            "drives were joined to one log, or the view was blocked.",
            "Look at the map there; cut the log at that time and give the parts as two logs.",
        ),
        "scene-change": FindingKind(
            "note",
            "the scene changes at once: {now:.0f} % of the returns lie on walls seen before, of the last scan "
            "{before:.0f} %, while the wheels tell {way:.2f} m ({times:.0f} times in all)",
            "As `scene-jump`, where places that were seen before and after hold both sides together: a robot that was "
            "carried is found again.",
            "Nothing.",
        ),
        "way-bent": FindingKind(
            "doubtful",
            "places bend its way by {value:.1f} m over {way:.0f} m, {sd:.0f} standard deviations of what scans and "
            "wheels tell of it",
            "Places that look alike pull the trajectory together, or wheels err more than is believed along walls that "
            "tell nothing.",
            "Look at the map there; say which places are false with `mapweave edit`.",
        ),
        "way-slid": FindingKind(
            "doubtful",
            "places say that it slid by {value:.1f} m about then; when is not known, scans there may be as far off",
            "Along walls that tell nothing, as in a bare corridor, scans were matched to where they do not lie, for "
            "some seconds. Many places hold what came before and what came after.",
            "Look at the map there; mask what is wrong with `mapweave edit`, or drive there again.",
        ),
        "way-loose": FindingKind(
            "doubtful",
            "where it was then is known to {value:.1f} m (one standard deviation)",
            "Walls tell little along the way, as in a bare corridor, nothing seen before ties a long way, or neither "
            "wheels nor sightings tell it: the map may be too long, too short or bent by as much.",
            "Drive back over places seen before, tell positions along the way, use a scanner that reaches farther, or "
            "record odometry.",
        ),
        "log-parted": FindingKind(
            "note",
            "what its log holds from then on is another place, to which nothing ties it: it is mapped as {value}",
            "From one scan to the next the robot saw another place, though its wheels hardly moved, and nothing was "
            "seen both before and after: it was carried, or two drives are in one file.",
            "Nothing; where the two are one building all the same, say so with `--decisions`.",
        ),
        "track-patchy": FindingKind(
            "doubtful",
            "the trajectory is cut {cuts:.0f} times among {keyframes:.0f} keyframes",
            "Scans are so far apart, or see so little in common, that many motions from one to the next are not sure. "
            "The pieces hang on places alone, and are off where those are few.",
            "Record more scans a metre, or drive through the same places again.",
        ),
        "start-unfound": FindingKind(
            "bad",
            "the start was not found: the hypotheses never became one",
            "`localize` does not know where the robot is in the map.",
            "Tell where it starts (--start), or give a longer log.",
        ),
        "start-given-up": FindingKind(
            "note",
            "{value:.0f} places found did not explain the scans and were given up",
            "`localize` searched the whole map again each time.",
            "Nothing where the start was found.",
        ),
        "decision-contradicted": FindingKind(
            "doubtful",
            "the place at {a:.2f} s and {b:.2f} s that is said to be one lies {sd:.0f} standard deviations from what "
            "the rest of the scans say",
            "A decisions file says that two moments saw one place, and the map bends to make it so.",
            "Look at the map there; take the row back.",
        ),
        "merge-contradicted": FindingKind(
            "doubtful",
            "{pair} are said to be together, and {alike:.0f} % of what both saw is alike",
            "A decisions file says that two robots' maps are one, and each saw through walls of the other.",
            "Look at the map there; give another pose in the row, or take it back.",
        ),
        "merge-forbidden": FindingKind(
            "note",
            "{value} are said to be apart, and their scans would merge them",
            "A decisions file says that two robots' maps are not one.",
            "Nothing, if that is so.",
        ),
        "robots-apart": FindingKind(
            "doubtful",
            "not in the first map: {value}; nothing ties them to it",
            "Each map is right by itself; how they lie to each other nobody knows.",
            "`fusion` in metrics.json says why of each pair. Tell where a robot starts (`--start`), or map logs of "
            "different buildings by themselves.",
        ),
    },
    "Position fixes": {
        "fixes-dropped": FindingKind(
            "note",
            "{n:.0f} fixes left out: {value}",
            "Messages that tell no position, or one that cannot be.",
            "Nothing.",
        ),
        "fixes-silent": FindingKind(
            "note",
            "no fixes for {value:.0f} s",
            "The receiver saw no satellites, or was off. What was seen carries the trajectory over.",
            "Nothing.",
        ),
        "fixes-untold": FindingKind(
            "note",
            "{value:.0f} fixes do not tell how sure they are",
            "Their noise is estimated from how they disagree with the trajectory.",
            "Nothing.",
        ),
        "fixes-worse": FindingKind(
            "note",
            "fixes err by {value:.1f} times what they say of themselves",
            "Each counts by what it was found to err.",
            "Look at the receiver's settings, and at where its antenna is said to stand.",
        ),
        "fixes-rejected": FindingKind(
            "note",
            "{far:.0f} of {n:.0f} fixes lie where the robot cannot have been, up to {value:.0f} m off",
            "Signals came round houses, or the receiver jumped.",
            "Nothing; `fixes.csv` tells which.",
        ),
        "fixes-unused": FindingKind(
            "doubtful",
            "its fixes are not used: {value}",
            "They say nothing of where the robot is to the others.",
            "Look whether they are of this drive; of another frame, leave one of both out (--fixes).",
        ),
        "fixes-vague": FindingKind(
            "note",
            "fixes tell the heading of the map to {value:.0f} degrees alone",
            "The robot moved too little for the noise of its fixes, or they are of another drive: where its map lies "
            "in the world is not known.",
            "Drive farther; look whether clocks agree.",
        ),
        "fixes-mirrored": FindingKind(
            "bad",
            "fixes are those of the mirrored way ({value:.0f} m off as they are)",
            "The sign of a latitude or of a longitude is wrong, or both are exchanged: another hemisphere.",
            "Look at what wrote the fixes.",
        ),
        "fixes-contradict": FindingKind(
            "bad",
            "{value:.0f} % of the fixes lie where the robots cannot have been",
            "Fixes and what was seen do not tell of one drive.",
            "Look whether clocks agree, and whether fixes and scans are of one robot.",
        ),
        "placed-by-fixes": FindingKind(
            "note",
            "nothing that was seen ties it to {other}: fixes place it in the world, to {value:.2f} m and "
            "{turn:.1f} degrees",
            "The maps are one by their fixes alone.",
            "Nothing, where that is sure enough.",
        ),
    },
    "Stamps": {
        "stamps-none": FindingKind(
            "note",
            "the log has no stamps: its scans are counted {value:g} s apart",
            "The format has none. Speeds mean nothing; the map does not depend on them.",
            "Nothing.",
        ),
        "stamps-equal": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} stamps of the {what} are those of the row before",
            "The stamps were written by nobody (all zero) or by something that held them: when a row was measured is "
            "not known. Rows are taken a second apart, or as far as the log states.",
            "Record again with the driver's own stamps, where speeds or several robots' clocks matter.",
        ),
        "stamps-rounded": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} stamps of the {what} are rounded to that of the row before",
            "Within a stamp the order of the file is the only one there is.",
            "Record with finer stamps.",
        ),
        "wheels-untimed": FindingKind(
            "doubtful",
            "nothing says when {value:.0f} rows of odometry were measured",
            "Stamps of scans or odometry are all equal: which rows belong together is not known, and poses come from "
            "scan matching alone.",
            "Record again with the driver's own stamps.",
        ),
        "stamps-back": FindingKind(
            "note",
            "stamps of the {what} step back in time {value:.0f} times",
            "The recording's clock was set back, or its rows are out of order.",
            "Nothing where it happens now and then. Look at the map where it happens often.",
        ),
        "stamps-mixed": FindingKind(
            "note",
            "{value:.0f} poses have stamps of one moment with others and lie elsewhere",
            "Stamps in the log are wrong, as where copies of one recording were merged or a logger was held up.",
            "Give the log as it was recorded.",
        ),
        "stamp-lag": FindingKind(
            "doubtful",
            "the scans bear stamps {value:.2f} s {way} those of the odometry of the same moments",
            "Every scan is given the odometry of another moment, and walls may lie wrong after turns.",
            "Set the scanner's clock, or correct the stamps by so much.",
        ),
        "clock-drift": FindingKind(
            "doubtful",
            "the clock of the scans runs {value:.1f} % {way} than that of the odometry",
            "Scans and odometry drift apart: every scan is given the odometry of another moment, the more the longer "
            "the log, and walls may lie wrong after turns.",
            "Stamp both by one clock, or scale the scans' stamps by so much.",
        ),
    },
    "Wheels and scans": {
        "no-odometry": FindingKind(
            "note",
            "no odometry: poses come from scan matching alone",
            "Nothing bridges what scans do not tell.",
            "Give the odometry, if it was recorded.",
        ),
        "turns-alone": FindingKind(
            "doubtful",
            "{times:.0f} turns from one scan to the next, the widest of {most:.0f} degrees, that nothing but the scans "
            "tells",
            "After a wide turn a scan sees little of what the one before it saw, and rooms that look alike pass for "
            "each other: the map may be wrong by a room.",
            "Record odometry or a gyroscope, scan more often, or turn more slowly.",
        ),
        "slides-alone": FindingKind(
            "doubtful",
            "over {value:.1f} m or more the walls in reach tell little along one direction, and nothing but the scans "
            "tells the way",
            "Along a bare corridor a scan fits wherever the robot is: the map may be too short or too long by metres.",
            "Record odometry, or use a scanner that reaches the corridor's ends or measures intensity.",
        ),
        "odometry-short": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} scans are outside the time of the odometry",
            "The wheels say nothing of where the robot was then; its last pose is taken.",
            "Look whether the two were recorded together.",
        ),
        "wheels-disagree": FindingKind(
            "doubtful",
            "the scans tell a way of {scans:.1f} m and the wheels one of {wheels:.1f} m",
            "Something moved along, the walls tell nothing along the way, or the wheels slip.",
            "Look at the map there, and compare with a length that you know.",
        ),
        "wheels-stand": FindingKind(
            "doubtful",
            "the wheels report no motion, here and {times:.0f} times in all, while the scans tell a way of {way:.1f} m",
            "Nothing but the scans tells the way, and along walls that look alike it may be wrong.",
            "Look whether the wheels' messages were lost.",
        ),
        "wheels-scale": FindingKind(
            "doubtful",
            "the scans move {value:.4g} +- {sd:.2g} times as far as the wheels tell",
            "The ranges or the wheels have another scale. The map is as large as the ranges make it, and wrong where "
            "it is they that are.",
            "Calibrate the wheels; compare the map with a length that you know.",
        ),
        "wheels-calibrated": FindingKind(
            "note",
            "{value}",
            "What the log tells of its wheels and of where the scanner stands differs from what was said, surely and "
            "by more than hardly matters: the map was made with what the log tells.",
            "Nothing; `--config` with `[laser.odometry] apply = false` maps the log as it is.",
        ),
        "scans-swept": FindingKind(
            "note",
            "scans take {value:.3f} s from their first beam to their last: each is taken from where the robot was then",
            "The scanner turns, as its driver states. Seen from a robot that turns or drives, what its beams hit lies "
            "elsewhere than where one place would have it. Beams given in reverse, as those of scanners are that turn "
            "clockwise, have a negative time.",
            "Nothing.",
        ),
        "wheels-unlike": FindingKind(
            "doubtful",
            "the scans move {value:.2g} times as far as the wheels tell",
            "One of the two is not in metres, or the odometry has a wrong sign or is of another log.",
            "Convert the odometry to metres.",
        ),
        "wheels-other": FindingKind(
            "bad",
            "the scans and the wheels tell different motions in {ways:.0f} % of the ways and {turns:.0f} % of the "
            "turns compared",
            "The odometry is of another log or has a wrong sign or unit, or the scanner sees what the robot carries.",
            "Look at the log's odometry; leave it out where it is wrong.",
        ),
        "wheels-fast": FindingKind(
            "doubtful",
            "the odometry tells {value:.0f} m/s while it drives",
            "No robot drives so fast: it is not in metres, or its stamps are not in seconds.",
            "Convert the odometry to metres and its stamps to seconds.",
        ),
        "wheels-leap": FindingKind(
            "doubtful",
            "the pose that the wheels tell leaps by {value:.1f} m and {degrees:.0f} degrees from one scan to the next "
            "({times:.0f} times in all)",
            "Something set the odometry's pose, its driver was started again, or drives were joined to one log.",
            "Cut the log at that time and give the parts as two logs.",
        ),
        "wheels-set": FindingKind(
            "note",
            "the pose that the wheels tell leaps by {value:.1f} m and {degrees:.0f} degrees from one scan to the next "
            "({times:.0f} times in all)",
            "Something set the odometry's pose, or its driver was started again. Scans tell the motion there; where "
            "they do not, a new segment begins (`track-cut`).",
            "Nothing, unless a segment is told to be apart.",
        ),
        "turns-scale": FindingKind(
            "doubtful",
            "the scans turn {value:.3f} +- {sd:.3f} times as far as the wheels tell",
            "The angles between the beams are wrong, and the map is bent, or the wheels' turns have another scale: no "
            "walls tell which.",
            "Look at the scanner's field of view in the log; calibrate the wheels.",
        ),
        "wheels-turns": FindingKind(
            "note",
            "the scans turn {value:.3f} +- {sd:.3f} times as far as the wheels tell, and the beams' angles are right",
            "The wheels' turns have another scale; the map is made by the scans.",
            "Calibrate the wheels: their distance, or what scales their turns.",
        ),
        "beams-apart": FindingKind(
            "bad",
            "the scans turn {value:.3f} +- {sd:.3f} times as far as the wheels tell, and walls are bent",
            "The angles between the beams are wrong, and so is the map.",
            "Correct the scanner's field of view, or the angle from beam to beam.",
        ),
        "scanner-askew": FindingKind(
            "note",
            "the scans move {degrees:.1f} +- {sd:.1f} degrees to the {side} of where the wheels lead",
            "The scanner's heading on the robot seems wrong by so little that scan matching makes up for it.",
            "Give the scanner's place with --sensor-pose.",
        ),
        "scanner-turned": FindingKind(
            "doubtful",
            "the scans move {degrees:.1f} +- {sd:.1f} degrees to the {side} of where the wheels lead",
            "The scanner's heading on the robot seems wrong by that, or the wheels' frame is.",
            "Give the scanner's place with --sensor-pose.",
        ),
        "beams-mirrored": FindingKind(
            "bad",
            "the scans turn against the odometry: beam angles seem to have the wrong sign",
            "The map is mirrored, or torn at every turn.",
            "Try --mirrored.",
        ),
        "robot-still": FindingKind(
            "note",
            "the robot hardly moved: {value:.1f} m",
            "The map is what was seen from one place.",
            "Nothing, if the robot was meant to stand.",
        ),
    },
    "Scans and light": {
        "log-short": FindingKind(
            "note",
            "{value}",
            "The file is damaged or was cut off; what was readable is used.",
            "Give the whole file, where there is one.",
        ),
        "few-scans": FindingKind(
            "doubtful",
            "the log holds {value:.0f} scans",
            "So few scans make no map that could contradict itself.",
            "Give a longer log.",
        ),
        "beams-change": FindingKind(
            "note",
            "the beam count changes: {value}",
            "Scans of several scanners or settings stand in one log.",
            "Nothing.",
        ),
        "scans-empty": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} scans have no return at all",
            "Nothing was in reach. The wheels carry the robot over such scans.",
            "Nothing where it is a few.",
        ),
        "scans-blind": FindingKind(
            "bad",
            "no scan of {value:.0f} has a return",
            "There is nothing to map: ranges are in another unit, or the scanner's limits in the log are wrong.",
            "Look at the ranges and their limits in the log.",
        ),
        "scans-sparse": FindingKind(
            "doubtful",
            "no scan of {value:.0f} has {least:.0f} returns",
            "That is too little to match: the scanner has few beams, or sees little. Poses are the wheels' alone.",
            "Look at the ranges and their limits in the log, or record more beams.",
        ),
        "ranges-nan": FindingKind(
            "note",
            "{value:.0f} ranges are not a number: read as no return",
            "The driver writes NaN where it saw nothing.",
            "Nothing.",
        ),
        "false-returns": FindingKind(
            "note",
            "{value:.0f} returns seem false and are in the map: {what}",
            "The scans went into the map before that was known.",
            "Map the log again from its recording.",
        ),
        "light-unused": FindingKind(
            "note", "the intensity of returns is not used: {value}", "Geometry alone makes the map.", "Nothing."
        ),
        "sensor-unplaced": FindingKind(
            "note",
            "{value}: the sensor is taken to stand at the robot's origin",
            "The log does not say where the scanner stands on the robot, or what it says moves.",
            "Give --sensor-pose if it stands elsewhere.",
        ),
        "cloud-sliced": FindingKind(
            "note",
            "scans are slices of {topic}, from {low:.2f} to {high:.2f} m above the {over}",
            "Point clouds were read: of every direction what is nearest between two heights, the floor left out where "
            "it is seen. Without a floor heights are counted from the scanner.",
            "Nothing; `--height LOW,HIGH` cuts elsewhere.",
        ),
        "scanner-tilted": FindingKind(
            "note",
            "the scanner leans by {value:.1f} degrees against the floor it sees, beside what transforms tell",
            "Points of a tilted scanner that are taken for level ones put the floor into the map.",
            "Mend the transform, so that programs that do not level can use the log.",
        ),
        "imu-turns": FindingKind(
            "note",
            "turns are those of the IMU on {value}",
            "The robot's turns are read from its gyroscope, about gravity, less the bias that it tells where scans "
            "show that the robot stands.",
            "Nothing.",
        ),
        "imu-mounted": FindingKind(
            "note",
            "gravity lies {value:.0f} degrees from where up is for the IMU by the transforms",
            "The inertial unit is mounted on its side or upside down (180 degrees), and no transform says so.",
            "Mend the transform.",
        ),
        "imu-unit": FindingKind(
            "note",
            "the IMU tells turns {value}, as scans show",
            "Scans turn by another amount or in another sense than the gyroscope says in radians about gravity.",
            "Mend the driver: other programs will believe it.",
        ),
        "imu-unlike": FindingKind(
            "doubtful",
            "the turns of the IMU on {value} are none that scans show",
            "The gyroscope is another robot's, has another clock, or is broken.",
            "Look at its stamps and units.",
        ),
        "robot-tipped": FindingKind(
            "doubtful",
            "the robot leans by up to {value:.0f} degrees",
            "Gravity points elsewhere than usual for a second and more: the robot stands on a ramp, was lifted or "
            "fell, and its scanner sees floor or ceiling.",
            "Look at the map there; cut the log.",
        ),
        "topics-chosen": FindingKind(
            "note",
            "{value}",
            "The recording holds several topics of one kind.",
            "Name another with --scan-topic or --odom-topic.",
        ),
        "logs-alike": FindingKind(
            "doubtful",
            "it and {other} hold the same scans, or were in one place at one time, at {same:.0f} of {all:.0f} "
            "keyframes: their logs seem to be copies of one drive",
            "One drive counts twice, and the map is surer than it should be.",
            "Leave one of the two out.",
        ),
        "log-twice": FindingKind(
            "note", "it is the same log as {value}", "A log that was given twice counts once.", "Nothing."
        ),
    },
    "Landmark logs": {
        "no-wheels": FindingKind(
            "note",
            "no odometry: mapped with a random walk between sightings",
            "Only what the robot saw tells where it was.",
            "Give the odometry, if it was recorded.",
        ),
        "saw-nothing": FindingKind(
            "note", "it saw nothing", "The robot adds nothing to the map.", "Look at its camera's log."
        ),
        "rows-impossible": FindingKind(
            "note",
            "{value:.0f} {what} rows held numbers beyond any robot",
            "They are damaged, or in another unit.",
            "Nothing where it is a few.",
        ),
        "subjects-told": FindingKind(
            "note",
            "its sightings tell subjects in place of barcodes: read as such",
            "The log has the names that landmarks have in the survey.",
            "Nothing.",
        ),
        "sightings-sifted": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} sightings contradict those of the same name moments before and after",
            "Labels were misread.",
            "Nothing where it is a few.",
        ),
        "tag-twice": FindingKind(
            "note",
            "in {value:.0f} frames {name} was seen at two places at once",
            "Two things bear one name, or one was misread.",
            "Look for a tag that was printed twice.",
        ),
        "landmark-moves": FindingKind(
            "note",
            "{name} was seen {value:.0f} times but at no fixed place",
            "It moves, or several things bear its name.",
            "Nothing.",
        ),
        "landmark-torn": FindingKind(
            "doubtful",
            "{value:.0f} of {all:.0f} sightings of {name} lie elsewhere than the others, when all is smoothed",
            "Two landmarks bear that name, or it was moved or misread: where robots saw it the map may be wrong.",
            "Look whether two landmarks bear that name; correct the labels or leave it out.",
        ),
        "sightings-doubted": FindingKind(
            "doubtful",
            "{value:.0f} of {all:.0f} sightings do not fit together with the others",
            "What the robot saw does not fit together, and its map may be wrong.",
            "Look at its labels and its odometry.",
        ),
        "sightings-inconsistent": FindingKind(
            "doubtful",
            "sightings disagree with the filter: median NIS {value:.1f}, expected about 1.4",
            "The noise is larger than the settings say, or the map is wrong.",
            "Look at its sensor; set the camera's noise.",
        ),
        "pieces-apart": FindingKind(
            "note",
            "{value:.0f} of {all:.0f} stretches of its log share too little with the others",
            "Without wheels a stretch is tied by landmarks alone.",
            "Nothing, or drive through known places.",
        ),
        "turns-unlike": FindingKind(
            "doubtful",
            "{value}",
            "What the robot sees turns otherwise than its wheels say: another sign, unit, robot or time.",
            "Look at its odometry.",
        ),
        "speeds-unlike": FindingKind(
            "doubtful",
            "{value}",
            "What the robot sees comes nearer otherwise than its wheels say: another sign or unit.",
            "Look at its odometry.",
        ),
        "camera-turned": FindingKind(
            "doubtful",
            "what its bearings call its {value} lies ahead: its sensor is mounted turned by about 90 degrees",
            "Wheels and sightings cannot be used together as they are.",
            "Correct the bearings.",
        ),
        "camera-clock": FindingKind(
            "note",
            "its camera's stamps are {value:.1f} s {way} its wheels'",
            "Camera and wheels have two clocks.",
            "Set the camera's clock.",
        ),
        "robot-clock": FindingKind(
            "note",
            "its clock is {value:.2f} s {way} the others' (sd {sd:.2f} s), by what they saw of each other",
            "The robots' clocks differ.",
            "Set the robots' clocks.",
        ),
        "robot-clock-maybe": FindingKind(
            "doubtful",
            "its clock seems {value:.2f} s {way} the others' (sd {sd:.2f} s), by what they saw of each other",
            "The robots' clocks may differ.",
            "Set the robots' clocks.",
        ),
        "map-mirrored": FindingKind(
            "note",
            "its map is the mirror image of the others'",
            "Its bearings have the other sign.",
            "Correct the bearings of its log.",
        ),
        "labels-exchanged": FindingKind(
            "note",
            "labels {labels} look exchanged{which}, {value:.2f} m off as they are",
            "Two landmarks bear each other's names in this robot's log.",
            "Correct the labels.",
        ),
        "landmarks-renamed": FindingKind(
            "doubtful",
            "{value:.0f} of its {all:.0f} landmarks bear other names than the others': it calls {names}",
            "By their names its landmarks lie elsewhere than the others put them; by where they lie they are the same "
            "ones under other names.",
            "Correct the names in its log. Where it drove in another place, give its log a map of its own.",
        ),
        "landmark-elsewhere": FindingKind(
            "note",
            "landmark {name} lies {value:.2f} m from where the others put it{which}",
            "It was moved between the drives, or misread.",
            "Nothing.",
        ),
        "maps-scales": FindingKind(
            "doubtful",
            "the maps of {pair} tell of the same landmarks {value:.0f} % farther apart in one than in the other",
            "The ranges and wheels of one of them are in another unit, or not calibrated.",
            "Find out which one has the wrong scale, and map its log anew with --calibration.",
        ),
        "maps-repeated": FindingKind(
            "doubtful",
            "every map was counted {value:.0f} times: overconfident by that factor",
            "The setting `repeats` of the paper's method was turned.",
            "Leave it at 1.",
        ),
        "clock-apart": FindingKind(
            "doubtful",
            "its clock has nothing in common with the others': {value:.0f} s lie between their stamps and its own",
            "What it and the others saw of each other is not of one time.",
            "Set the robots' clocks.",
        ),
        "put-down": FindingKind(
            "note",
            "put down elsewhere at {value}",
            "The robot was carried; its own map is of the longest stretch.",
            "Nothing.",
        ),
        "unplaced": FindingKind(
            "doubtful",
            "{value}",
            "Too little tells where the robot was; that part of its path is left out.",
            "Drive where other robots or known landmarks are seen.",
        ),
        "fits-otherwise": FindingKind(
            "doubtful",
            "what was seen fits another map about as well, with landmarks or robots up to {value:.2f} m elsewhere",
            "Too few sightings, too noisy or too many of them wrong, tell where robots were.",
            "Drive longer, or let robots see each other and the same landmarks more often.",
        ),
        "placed-anew": FindingKind(
            "note",
            "no map of its own fits the others', {value:.0f} of {all:.0f} sightings place it",
            "A filter that believed wrong sightings early was left out, or the robot saw no landmark; its log was not.",
            "Nothing.",
        ),
        "rooms-tied": FindingKind(
            "note",
            "{value:.0f} landmarks that robots {robots} mapped apart are tied by {agree:.0f} of {all:.0f} sightings of "
            "each other",
            "Rooms without a landmark in common were joined by what the robots saw of each other.",
            "Nothing.",
        ),
        "not-smoothed": FindingKind(
            "doubtful",
            "not smoothed: {value}",
            "The map is the filters'.",
            "Look at the other findings.",
        ),
        "steps-longer": FindingKind(
            "note",
            "so much was driven that a robot's pose is estimated every {step:.2g} s at most, which keeps the problem "
            "within about {poses:,.0f} poses ([smoothing] most_poses)",
            "Between these poses the wheels tell the way.",
            "Raise `most_poses`, where memory allows it.",
        ),
        "smoothed-late": FindingKind(
            "note",
            "--online: {value}",
            "Nothing was smoothed before the logs' end where there were no wheels.",
            "Nothing.",
        ),
    },
    "Ranges": {
        "range-outliers": FindingKind(
            "note",
            "{far:.0f} of {n:.0f} ranges ({share:.0f} %) are too long or too short by more than three standard "
            "deviations, most of all those between {pair} ({worst:.0f} %)",
            "Ranges that went past a wall or a person are too long. They are rejected, and those that agree are used.",
            "Nothing, unless most are rejected.",
        ),
        "range-ambiguous": FindingKind(
            "doubtful",
            "{value}",
            "Ranges alone leave several places open, as a circle and its mirror image: those that explain the ranges "
            "about as well are all told, and the map shows the best.",
            "Drive round a corner while ranging, add a beacon or robot off the line, or tell where one is known.",
        ),
        "range-biases": FindingKind(
            "doubtful",
            "ranges between {pair} read {bias:.1f} m too long, and those of all pairs differ by {value:.1f} m in that: "
            "radios differ by decimetres",
            "How much too long a pair's ranges are is estimated with the map. That they are so unlike makes up for "
            "robots or beacons that stand elsewhere, as where robots drove too little or ranges went past walls.",
            "Drive farther while ranging; look at the map, and whether each radio is on the robot it is said to be on.",
        ),
        "ranges-drift": FindingKind(
            "doubtful",
            "ranges keep to no one place and bias: for {share:.0f} % of the time they are off together, most those "
            "between {pair}, by {value:.1f} m",
            "Radios drift as they warm up, a beacon was moved, two bear one name, or somebody lies wrong: the map may "
            "be bent by as much.",
            "Look at `ranges.csv` for when ranges are off, cut the log there, and let beacons stand.",
        ),
        "range-unplaced": FindingKind(
            "doubtful",
            "is not in the map: {value}",
            "Ranges do not observe where it is: there are too few, or nobody moved enough between them.",
            "Drive further while ranging, not on one straight line, and with more of the others in reach.",
        ),
        "heading-unobserved": FindingKind(
            "doubtful",
            "its heading is not observed: it stood still",
            "Ranges tell where a standing robot is and not which way it faces; its heading is drawn as it began.",
            "Drive it a metre or more.",
        ),
        "odometry-denied": FindingKind(
            "note",
            "ranges tell another motion than its odometry; its track is cut there",
            "The robot was carried, its wheels slipped, or its odometry began anew. What came before and after is laid "
            "by ranges alone.",
            "Look at its odometry, unless it was carried.",
        ),
        "odometry-unlike": FindingKind(
            "doubtful",
            "ranges tell another motion than its odometry {value:.0f} times",
            "Odometry that has to be cut so often has another scale or unit, or is of another robot or time, and bends "
            "what lies between.",
            "Look at its odometry.",
        ),
        "odometry-gap": FindingKind(
            "note",
            "no odometry for {value:.1f} s",
            "The robot may have been anywhere meanwhile: what came before and after is laid by ranges, and ranges that "
            "were measured meanwhile are left out.",
            "Look for lost messages.",
        ),
        "odometry-slips": FindingKind(
            "note",
            "its odometry errs by {value:.0f} times what it does mostly, by its ranges",
            "Its wheels slip for a while, or its odometry has another scale then: it counts by as much less.",
            "Look at its odometry.",
        ),
        "range-lag": FindingKind(
            "note",
            "its ranges bear stamps {value:.2f} s {way} those of its odometry of the same moments",
            "Radios and odometry are stamped by different clocks, or one of both late: ranges are moved in time by so "
            "much.",
            "Nothing; stamp both when they are measured.",
        ),
        "range-clock": FindingKind(
            "note",
            "stamps of its ranges move by {value:.2f} s against those of its odometry over the log",
            "Radios and odometry are stamped by clocks that run apart: ranges are moved in time by so much.",
            "Nothing; stamp both by one clock.",
        ),
        "range-stamps": FindingKind(
            "note",
            "stamps of ranges scatter by {value:.2f} s",
            "Ranges err the more the faster robots drive: their stamps are rounded, or messages were held up. They "
            "count by as much less.",
            "Stamp ranges when they are measured.",
        ),
        "range-growth": FindingKind(
            "note",
            "biases of ranges grow: by {value:.2f} m over the log between {pair}",
            "Radios that grow warm read longer. How each pair's bias grows is found with it.",
            "Nothing.",
        ),
        "range-dropped": FindingKind(
            "note",
            "{n:.0f} ranges were dropped: {value}",
            "They cannot be what was measured, or nothing says where the robot was then.",
            "Look at the log, unless they are few.",
        ),
        "ranges-worse": FindingKind(
            "note",
            "ranges scatter by {value:.2f} m, {times:.1f} times what the graph states of them",
            "Each counts by what it was found to err.",
            "Look at what wrote the variances.",
        ),
        "ranges-contradict": FindingKind(
            "bad",
            "most ranges contradict each other and the odometry: {far:.0f} of {n:.0f} are rejected",
            "No arrangement of the robots explains what was ranged. Radios may be taken for those of other robots.",
            "Say which radio is on which robot (`--radios`).",
        ),
        "radios-assumed": FindingKind(
            "note",
            "radios and robots are called differently; by their numbers, or being two, it is {value}",
            "Ranges name radios and odometry names robots, and nothing in the log says which radio is on which robot.",
            "Say so by `--radios` where it is otherwise.",
        ),
        "stamps-recorded": FindingKind(
            "note",
            "{value}: all go by when they were recorded",
            "Stamps of messages come from computers whose clocks are apart.",
            "Nothing, where messages were recorded as they came.",
        ),
    },
    "Options and files": {
        "start-contradicted": FindingKind(
            "doubtful",
            "what was seen puts its start {value:.2f} m from the one given",
            "The start that was told and what was seen do not fit together; what was seen counts.",
            "Correct --start.",
        ),
        "survey-contradicted": FindingKind(
            "doubtful",
            "landmark {name}: what was seen puts it {value:.2f} m from where it was surveyed",
            "The survey or the map is wrong there.",
            "Measure it again.",
        ),
        "option-idle": FindingKind(
            "note", "{option} has no effect: {value}", "The option is for another job.", "Leave it out."
        ),
        "truth-unscored": FindingKind(
            "note",
            "the truth: nothing to score: {value}",
            "The result is as it would be without the truth.",
            "Look whether stamps and names are those of the log.",
        ),
        "network-open": FindingKind(
            "doubtful",
            "anyone who reaches the network could have written this map: nobody had to show a certificate (--insecure)",
            "The map process heard other machines without certificates.",
            "`mapweave live keys --out keys --robots r1,r2` makes certificates for a team.",
        ),
        "network-told": FindingKind(
            "doubtful",
            "{value}",
            "Something that came over the network was not believed, a robot was left out of the map, or what the map "
            "process runs on failed.",
            "Look which robot sent it, and whether its log alone gives a map; of a damaged store, look at the disk.",
        ),
        "told-before": FindingKind(
            "note",
            "{value}",
            "A result of an earlier version holds its warnings as sentences alone.",
            "Map the logs again for a verdict.",
        ),
    },
}
KINDS: dict[str, FindingKind] = {code: kind for section in SECTIONS.values() for code, kind in section.items()}


ASKEW = math.radians(15.0)  # by which a scanner may be turned on its robot and the map be right


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong or worth knowing.

    code: of the table; robot: its key, None where it is of the whole; span: stamps [s] from and to; value: the number
    that was measured, or several by name, as the code's text asks for them; action: what was done about it.
    """

    code: str
    robot: str | None = None
    span: tuple[float, float] | None = None
    value: Value = None
    action: str = ""

    def __post_init__(self) -> None:
        if self.code not in KINDS:
            msg = f"no finding is called {self.code!r}"
            raise ValueError(msg)
        if self.robot is not None:
            object.__setattr__(self, "robot", robot_key(self.robot))

    def __hash__(self) -> int:
        return hash((self.code, self.robot, self.span, self.action))

    @property
    def severity(self) -> Severity:
        return KINDS[self.code].severity

    @property
    def text(self) -> str:
        """The sentence, without the robot's name."""
        given = self.value if isinstance(self.value, Mapping) else {"value": self.value}
        sentence = KINDS[self.code].text.format(**given)
        return f"{self._when}{sentence}" + (f"; {self.action}" if self.action else "")

    @property
    def told(self) -> str:
        """The sentence with the robot's name, where it is of one."""
        return self.text if self.robot is None else f"robot {self.robot}: {self.text}"

    @property
    def _when(self) -> str:
        if self.span is None:
            return ""
        first, last = self.span
        return f"at {first:.1f} s: " if first == last else f"from {first:.1f} s to {last:.1f} s: "

    def row(self) -> dict[str, Any]:
        """As it stands in `metrics.json`."""
        first, last = (None, None) if self.span is None else self.span
        value = dict(self.value) if isinstance(self.value, Mapping) else self.value
        return {
            "code": self.code,
            "robot": self.robot,
            "from": first,
            "to": last,
            "value": value,
            "action": self.action,
            "text": self.text,
        }


def finding_of(row: object) -> Finding:
    """The finding of a row that `Finding.row` made. Raises ValueError for anything else."""
    if not isinstance(row, Mapping) or row.get("code") not in KINDS:
        msg = f"expected a finding, found {row!r:.80}"
        raise ValueError(msg)
    first, last = row.get("from"), row.get("to")
    robot = None if row.get("robot") is None else str(row["robot"])
    try:
        span = None if first is None or last is None else (float(first), float(last))
        found = Finding(str(row["code"]), robot, span, row.get("value"), str(row.get("action", "")))
        _ = found.text
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        msg = f"{row['code']}: expected the values of its text, found {row.get('value')!r:.80}"
        raise ValueError(msg) from None
    return found


@dataclass(frozen=True, slots=True)
class Unused:
    """Messages of a recording, or rows of a log, that no reader took. type: as the format calls it."""

    source: str
    topic: str
    type: str
    messages: int
    reason: str

    def row(self) -> dict[str, Any]:
        """As it stands in `metrics.json`."""
        return {
            "source": self.source,
            "topic": self.topic,
            "type": self.type,
            "messages": self.messages,
            "reason": self.reason,
        }


def unused_by_all(logs: Iterable[tuple[str, Sequence[Unused]]]) -> list[Unused]:
    """What no log used, of (source, what this log did not use): robots of one recording use each its own topics."""
    told = list(logs)
    out: dict[tuple[str, str], Unused] = {}
    for left in (left for _, unused in told for left in unused):
        beside = [unused for source, unused in told if source == left.source]
        if all(any(other.topic == left.topic for other in unused) for unused in beside):
            out.setdefault((left.source, left.topic), left)
    return list(out.values())


def unused_of(row: object) -> Unused:
    """What `Unused.row` made the row of. Raises ValueError for anything else."""
    if not isinstance(row, Mapping) or set(row) != {"source", "topic", "type", "messages", "reason"}:
        msg = f"expected what was recorded and not used, found {row!r:.80}"
        raise ValueError(msg)
    count = row["messages"]
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        msg = f"messages: expected a count, found {count!r:.80}"
        raise ValueError(msg)
    return Unused(str(row["source"]), str(row["topic"]), str(row["type"]), count, str(row["reason"]))


def turned_scanner(robot: str, direction: float, sd: float) -> Finding:
    """The scans move by `direction` +- `sd` [rad], left positive, beside where the wheels lead."""
    side = "left" if direction > 0 else "right"
    told: dict[str, float | str] = {"degrees": math.degrees(abs(direction)), "sd": math.degrees(sd)}
    told["side"] = side
    if abs(direction) <= ASKEW:
        return Finding("scanner-askew", robot, value=told)
    return Finding("scanner-turned", robot, value=told)


def of_robot(findings: Iterable[Finding], robot: str) -> tuple[Finding, ...]:
    """The findings as those of `robot`, whoever they were of."""
    return tuple(replace(f, robot=robot) for f in findings)


def verdict(findings: Iterable[Finding]) -> Verdict:
    """`good` where nothing doubts the result, else what the gravest finding makes of it."""
    grave = {f.severity for f in findings}
    return "bad" if "bad" in grave else "doubtful" if "doubtful" in grave else "good"


MOST_ALIKE = 3  # findings of one code and robot that are told in full


def shortly(findings: Sequence[Finding], *, named: bool = False) -> list[str]:
    """What people read, `named` with their robots: of each code and robot the first few, and how many more."""
    of = Counter((f.code, f.robot) for f in findings)
    seen, lines = Counter[tuple[str, str | None]](), []
    for f in findings:
        key = f.code, f.robot
        seen[key] += 1
        if seen[key] <= MOST_ALIKE or of[key] == MOST_ALIKE + 1:
            lines.append(f.told if named else f.text)
        elif seen[key] == MOST_ALIKE + 1:
            whose = f"robot {f.robot}: " if named and f.robot is not None else ""
            lines.append(f"{whose}{of[key] - MOST_ALIKE} more of {f.code}: metrics.json has all")
    return lines


def verdict_line(findings: Sequence[Finding]) -> str:
    """The verdict and the codes that made it, in a line for people."""
    robots: dict[str, list[str]] = {}
    for f in findings:
        if f.severity != "note":
            of = robots.setdefault(f.code, [])
            if f.robot is not None and f.robot not in of:
                of.append(f.robot)
    told = [f"{code} (robot {', '.join(of)})" if of else code for code, of in robots.items()]
    return f"verdict: {verdict(findings)}" + (f": {'; '.join(told)}" if told else "")


def table_page() -> str:
    """The page of the documentation: every code, what it makes of the verdict, what it means, what to do."""
    lines = [
        "# Findings",
        "",
        "Every result of `map` and `fuse` has a verdict, `good`, `doubtful` or `bad`: in `metrics.json` (`verdict`, of",
        "the whole and of each robot), on the terminal's last lines, at the head of `report.html`, and as",
        "`result.verdict` from Python. It is what the gravest of its findings makes of it; a note changes nothing.",
        "With `--strict` the command ends with exit code 1 unless the verdict is good; the result is written all the",
        "same.",
        "",
        "A finding has a code, the robot, a span of time, a value and what was done about it: `findings` in",
        "`metrics.json`, `result.findings` from Python. These are the codes.",
    ]
    for name, kinds in SECTIONS.items():
        lines += ["", f"## {name}"]
        for code, kind in kinds.items():
            made = "a note" if kind.severity == "note" else f"makes the verdict {kind.severity}"
            lines += ["", f"### `{code}`", "", f"{made[0].upper()}{made[1:]}. {kind.means}", "", f"To do: {kind.do}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table_page(), end="")  # noqa: T201  (the page is what this is for)
