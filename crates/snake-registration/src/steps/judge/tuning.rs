//! The constants of step 6.

use crate::tuning::tuning;

tuning! {
    /// A transform is reliable from this confidence on.
    reliable: f64 = 0.5, unit "probability", from "by the definition of the bias, a probability of about 0.95";
    /// A cloud looks like itself only at places that are this far apart; a shift up to this length is short.
    elsewhere: f64 = 4.0, unit "inlier distances", from "so that no match is of a place with itself";
    /// Number of places of each cloud on which two transforms are compared, at most.
    places: usize = 1000, unit "places", from "set for time";
    /// Number of places whose details are compared.
    shift_places: usize = 1200, unit "places", from "set for time";
    /// Number of places where pairs of them are compared: that are matched with others of their cloud, and that contradict
    /// sensors at one place.
    few_places: usize = 600, unit "places", from "set for time";
    /// Number of other candidates that may be rivals of the best, of moves that are compared for a turn, and of shifts along one
    /// axis, at most.
    tries: usize = 2, unit "transforms", from "as many as `refine` refines beside the best (3738705)";
    /// Number of ICP steps after a motion.
    rival_steps: usize = 8, unit "steps", from "set for time";
    /// Width of the cells in which details repeat, the step from one shift to the next, and the distance to which places that
    /// contradict sensors at one place are thinned.
    detail: f64 = 0.25, unit "inlier distances", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Number of motions under which a cloud looks like itself, at most.
    self_motions: usize = 10, unit "motions", from "set for time";
    /// A cloud looks like itself after a motion on which this share of these matches agrees.
    min_self_support: f64 = 0.06, unit "share of the matches",
        from "stairs have 0.10 to 0.31, stairwells 0.07 to 0.25, ramps 0.07 to 0.09; beside right answers real and made rooms 0.01 to 0.06 (tests/bench/alike_pairs.py, seeds 0 to 2, and 24 validation pairs)";
    /// Where the sensors are at one place, a motion that turns by less is a slide, of which no support is asked.
    max_slide_turn: f64 = 12.0, unit "degrees", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Such a motion is longer where the sensors are not known: objects have details alike side by side.
    min_unsigned_motion: f64 = 12.0, unit "inlier distances", from "an object in a map has 7 to 11";
    /// A rival contradicts at most this of the places that tell the two apart: usually; with sensors at one place, where one
    /// pattern of rays coincides point by point; and, of all places, after a shift there or one with which details fit better.
    self_contradicted: [f64; 3] = [0.08, 0.28, 0.43], unit "shares of the places that the winner explains and that tell",
        from "stairs, ramps and stairwells have up to 0.05, right answers in real rooms 0.09 and more; at one place traffic up to 0.25, rooms at rest 0.33 and more; pillars up to 0.38 of all places (tests/bench/alike_pairs.py, seeds 80 to 89, and 97 validation pairs)";

    /// Another transform is a rival if its fit of the surfaces is above this share of the best fit.
    rival_fit: f64 = 0.9, unit "share of the best fit", from "set by hand in c29aabe";
    /// A rival has this share of the matches that agree with the best, each count raised by one.
    rival_agreeing: f64 = 0.4, unit "share of the matches", from "half and twice change no outcome (tests/bench/sensitivity.py)";

    /// A patch constrains a motion whose cosine to its normal is above this: about 75 degrees.
    /// Normals of planar patches are better than that, those of slopes that a voxel does not show
    /// are not.
    min_motion_cosine: f64 = 0.25, unit "cosine", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// A direction of motion is open if patches resist at most this share of their squared motion.
    open_direction: f64 = 5e-5, unit "share of the squared motion", from "half and twice change no outcome (tests/bench/sensitivity.py); rooms and streets have 0.03 to 0.2";
    /// Where few points lie on patches, the overlap fixes all motions if slides fit worse by this.
    fixed_margin: f64 = 0.07, unit "overlap",
        from "slides fit worse by up to 0.04 in corridors and tunnels whose patches noise hides (190fc07)";
    /// A motion with a smaller rotation part is named a translation.
    no_rotation: f64 = 0.1, unit "length of the rotation part", from "set by hand in c29aabe";
    /// Distances by which the source slides to either side.
    slides: [f64; 6] = [2.0, 3.0, 4.0, 6.0, 9.0, 12.0], unit "inlier distances", from "half and twice change no outcome (tests/bench/sensitivity.py)";

    /// A patch tells whether a shift is right if the cosine between its normal and the shift is
    /// above this: a floor agrees with all shifts along it.
    repeat_cosine: f64 = 0.5, unit "cosine", from "set by hand in b0e7886";
    /// Number of patches that are compared for a shift, at most.
    repeat_patches: usize = 40, unit "patches", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Number of normals among which the most frequent directions are searched, at most.
    repeat_normals: usize = 50, unit "normals", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Number of patches that a shift needs.
    min_repeat_patches: usize = 7, unit "patches", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Shifts that settle closer to each other are one.
    repeat_settled: f64 = 0.1, unit "inlier distances", from "set for time in 8e0d76d";
    /// A shifted patch agrees with a patch whose plane is closer than this.
    repeat_tolerance: f64 = 0.12, unit "inlier distances", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// A shift is dropped early if too few of every so many patches are near other patches.
    repeat_probe: usize = 4, unit "patches", from "set for time in 789af6c";
    /// Number of least-squares steps by which a shift settles.
    repeat_steps: usize = 2, unit "steps", from "set for time in 8e0d76d";
    /// Length of the shortest shift.
    min_repeat: f64 = 1.0, unit "inlier distances", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Length of the longest shift.
    max_repeat: f64 = 10.0, unit "inlier distances", from "set for time in 8e0d76d";
    /// Share of the patches that must agree with a shift; the others may have left the view.
    min_repeat_share: f64 = 0.2, unit "share of the patches", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Shares of the patches up to this are treated as zero.
    min_repeat_fit: f64 = 0.3, unit "share of the patches in view", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Parts of a shift at one of which the surfaces must fit worse.
    repeat_parts: [f64; 3] = [0.35, 0.5, 0.65], unit "share of the shift", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Surfaces fit worse part of the way if less than this share of the agreement is left.
    repeat_valley: f64 = 0.6, unit "share of the agreement", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Two normals are parallel if their cosine is above this.
    repeat_parallel: f64 = 0.98, unit "cosine", from "set by hand in 9784128";
    /// A normal lies across another if this much of it is left without the other's direction.
    min_across: f64 = 0.5, unit "length", from "set by hand in 9784128";
    /// The target repeats itself if more than this share of the patches agrees after a shift.
    repeated: f64 = 0.45, unit "share of the patches in view",
        from "set in 00e891e: of 162 made rows of pillars 3 are left by one period";
    /// The source may belong to the other place if its fitness is above this: with less overlap, a
    /// place with more would fit better.
    repeated_fitness: f64 = 0.8, unit "share of the voxels", from "set by hand in 40795b4";

    /// Number of offsets along each axis at which planes of a rotated source are laid on planes.
    turn_offsets: usize = 3, unit "offsets", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// A rotated source must overlap the target by this, and have as much of the voxels on planes that meet.
    turn_share: f64 = 0.7, unit "share of the winner's",
        from "with 0.45 three instead of five of ten lobbies are wrong and reliable, but a right desk and a right room are not reliable";
    /// A place faces along an axis if its cosine is above this.
    shift_cosine: f64 = 0.8, unit "cosine", from "set by hand";
    /// Length of the longest shift.
    max_shift: f64 = 0.5, unit "share of the overlap's extent", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// A rival moves the source by more than this.
    min_shift: f64 = 2.25, unit "inlier distances", from "details of real rooms repeat after 1.4 and 2.1";
    /// Share of the details that must be in view after a shift, and fit.
    min_shift_view: f64 = 0.25, unit "share of the details that fit at rest", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Details repeat after a shift if of those in view this share more fits than after most shifts.
    shift_fit: f64 = 0.5, unit "share of the same beside rest", from "half and twice change no outcome (tests/bench/sensitivity.py); seen on a wall with windows every 1.5 m";
    /// After a short shift this share of them fits.
    min_short_fit: f64 = 0.4, unit "share of the details in view",
        from "0.41 to 0.8 on a made wall, 0.2 to 0.35 in most real rooms";
    /// On the way to a shift the details fit worse than this.
    shift_valley: f64 = 0.9, unit "share of that after the shift", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Every so many of them tell where exactly a shift fits.
    shift_thinning: usize = 6, unit "places", from "set for time";
    /// Number of steps to either side in which a shift is made exact.
    shift_steps: i32 = 6, unit "steps", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// A rival's surfaces fit by this: usually, and after a slide with sensors at one place.
    rival_fit_shares: [f64; 2] = [0.75, 0.43], unit "shares of the winner's fit",
        from "stairs have 0.9, ramps 0.89, an aeroplane of 4096 points after a half turn 0.69 to 0.77; traffic that keeps pace 0.44 to 0.54 (tests/bench/alike_pairs.py, seeds 80 to 89)";
    /// A shift is not made exact if fewer of the places lie on the target there, less those that
    /// contradict it.
    min_shift_score: f64 = 0.3, unit "share of the places", from "set for time";
    /// A rival that contradicts more, and explains less, is not refined.
    hopeless: f64 = 0.5, unit "share of the places that the winner explains", from "set for time";
    /// A cloud was seen from one place if this much of it is visible from there.
    min_one_view: f64 = 0.98, unit "share of the fine voxels",
        from "made scans have 0.99 and more, fused fragments of rooms about 0.9";
    /// Two sensors that are closer are at one place.
    standing: f64 = 1.0, unit "inlier distances",
        from "18 of 19 made facades and fences that were wrong and reliable, the last has 1.6";
    /// Sensors at one place see the same: a greater share of what one sees and the other does not is
    /// doubtful.
    max_standing: f64 = 0.2, unit "share of the places in view",
        from "0.25 to 0.4 at most wrong fences, up to 0.16 in made rooms that one sensor saw before and after half of it moved";
    /// They hang together if one slide brings this share of them onto each other.
    together: f64 = 0.2, unit "share of the places",
        from "posts beside a motorway have 0.2 to 0.6, beside vehicles that drift (tests/bench/alike_pairs.py, seeds 0 to 7)";
    /// Number of slides that are tried, at most.
    slides_together: usize = 40, unit "slides", from "half and twice change no outcome (tests/bench/sensitivity.py); things that moved alone come first";
    /// Places that hang together are a part of the scene, not one thing that moved, if they spread by this.
    min_together_spread: f64 = 0.31, unit "share of the cloud's spread",
        from "posts beside a motorway have 0.315 to 0.63, one car 0.05, furniture up to 0.3 (same pairs, seeds 0 to 11 and 62)";
    /// A mirror image fits better if it leads by this.
    mirror_lead: f64 = 0.06, unit "share of the places that the winner explains",
        from "mirrored boxes have 0.1 and more";

    /// A weaker constraint is doubtful, however many matches agree.
    doubtful_constraint: f64 = 2e-4, unit "share of the squared motion", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Fewer matches that agree are never enough, however well the surfaces fit.
    min_agreeing: usize = 10, unit "matches", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Matches with a smaller spread lie on one plane or line and do not fix a transform, however
    /// many agree.
    min_match_spread: f64 = 0.25, unit "inlier distances", from "half and twice change no outcome (tests/bench/sensitivity.py)";
    /// Share of the patches that coincide under a right transform.
    min_coinciding: f64 = 0.8, unit "share of the patches",
        from "right transforms of sweeps have 0.85 and more, wrong ones 0.75 and less (e823698)";
    /// Greatest confidence of a transform that is ambiguous, has few matches or leaves the surfaces
    /// apart.
    max_doubtful: f64 = 0.49, unit "probability", from "just below `reliable`";

    /// Bias of the logistic regression.
    bias: f64 = -8.5, unit "log-odds",
        from "3.2 below that of the fit by tests/bench/fit_verdict.py (00e891e), so that 0.5 is a probability of about 0.95";
    /// Weight of the logarithm of one more than the matches that agree, and the limit up to which it counts, so that no evidence
    /// outvotes the others. So it is with the rows that follow.
    log_agreeing: [f64; 2] = [1.88, 5.3], unit "log-odds; logarithm", from "tests/bench/fit_verdict.py on 785 pairs (e823698)";
    /// Of the logarithm of their ratio to those of the best rival.
    log_ratio: [f64; 2] = [0.43, 1.5], unit "log-odds; logarithm", from "tests/bench/fit_verdict.py on 785 pairs (e823698)";
    /// Of the slide margin.
    slide_margin: [f64; 2] = [22.5, 0.1], unit "log-odds per overlap; overlap",
        from "tests/bench/fit_verdict.py on 785 pairs (e823698)";
    /// Of the spread of the matches that agree.
    match_spread: [f64; 2] = [3.0, 1.0], unit "log-odds per inlier distance; inlier distances",
        from "tests/bench/fit_verdict.py on 785 pairs (e823698)";
    /// Of the violated free space.
    violation: [f64; 2] = [-302.0, 1.0], unit "log-odds per share of the voxels; share",
        from "tests/bench/fit_verdict.py on 785 pairs (e823698)";
    /// Of the lead over the next transform, where single matches were compared.
    lead: [f64; 2] = [10.0, 0.25], unit "log-odds per overlap; overlap",
        from "set by hand on pairs of hotel_uc and redkitchen: 0.2 and more if right, 0.1 and less in most wrong ones";
    /// With a smaller lead the next transform is a rival, where single matches were compared.
    min_lead: f64 = 0.3, unit "share of the score", from "set by hand on the same pairs";
    /// Number of the source's voxels that tell its scale, at most.
    scale_points: usize = 1500, unit "voxels", from "set for time";
    /// Number of steps to the factor, at most.
    scale_steps: usize = 12, unit "steps", from "set by hand";
    /// A factor that differs from 1 by less after one step is not pursued.
    scale_gate: f64 = 0.003, unit "ratio", from "set for time";
    /// Fewer pairs of voxels do not tell the scale.
    min_scale_pairs: usize = 100, unit "pairs", from "set by hand";
    /// Planes tell the scale if this much of their squared distance under a change of scale is left
    /// after the best rigid motion: three walls of a room fit at any scale.
    min_scale_share: f64 = 0.02, unit "squared extents of the pairs", from "set by hand";
    /// A smaller difference from 1 is not noted.
    min_scale: f64 = 0.01, unit "ratio", from "the smallest that matters";
    /// A factor differs from 1 if it does by so many of its standard deviations.
    scale_deviations: f64 = 5.0, unit "standard deviations", from "set by hand";
    /// The factor is found when a step changes it by less.
    scale_tolerance: f64 = 1e-4, unit "ratio", from "set by hand";
    /// With the factor, this share of the squared distances is left at most.
    scale_gain: f64 = 0.6, unit "share of the squared distances", from "set on training scenes and objects of true scale";
    /// The halves of the overlap change the factor by this at most.
    scale_disagreement: f64 = 0.2, unit "share of the change", from "set on training scenes and objects of true scale";
    /// Clouds whose diameters differ by more than this factor are probably in different units.
    unit_ratio: f64 = 30.0, unit "ratio of diameters", from "set by hand in c29aabe";
}
