//! Step 6: whether the best transform can be relied on.

mod alike;
mod comparison;
mod constants;
mod constraint;
mod corner;
mod evidence;
mod fitting;
mod open_motions;
mod repeats;
mod rival;
mod rivals;
mod scale;
mod shifts;
mod slide;
mod standing;
mod together;
mod turns;

use constants::TRIES;
pub(crate) use constants::{MAX_DOUBTFUL, RELIABLE, REPEATED};
use nalgebra::{IsometryMatrix3, Matrix6};

use crate::cloud::patches::{self, overlap};
use crate::cloud::planes::{information, plane_pairs};
use crate::cloud::surface::{Surface, fitness};
use crate::result::{CloudReport, Fit, Hypothesis, Matches, Registration, Verdict, ViewpointUsed};
use crate::steps::matches::{Match, inliers};
use crate::steps::pair::Pair;
use crate::steps::refine::{Candidate, refine};
use constraint::Constraint;
use corner::corner_note;
use evidence::{Evidence, is_rival};
use repeats::axes;
use rival::Rival;
use rivals::rivals;
pub(crate) use scale::best_scale;
use scale::scale_note;
use slide::slide_margin;
use snake_core::{Control, Error, Result};
use snake_geometry::{RigidTransform, least_spread};
use standing::are_at_one_place;
use together::together_note;

/// The next transform is a rival if the lead over it is smaller than this, where single matches
/// were compared. Unit: share of the score. Set by hand on pairs of hotel_uc and redkitchen.
const MIN_LEAD: f64 = 0.3;
/// Clouds whose diameters differ by more than this factor are probably in different units. Unit: ratio of diameters.
/// Set by hand.
const UNIT_RATIO: f64 = 30.0;

/// Largest share of patches within the inlier distance that lie apart, given their thickness. Of wrong sides of houses 12 of 14 have
/// 0.045 to 0.11; right answers in 189 pairs of real rooms have 0 to 0.026, in made scenes up to 0.013.
const MAX_APART: f64 = 0.03;
/// The same of those that face along one axis, because ground and guard rails coincide whatever a sensor did. Of vehicles that keep
/// pace with it, but not to the centimetre, 0.16 to 1 lie apart, in scenes at rest up to 0.25.
const MAX_APART_ALONG: f64 = 0.5;
/// Number of rivals that notes name, at most. A ring of columns has many.
const MAX_NOTES: usize = 3;

/// Makes the registration of the best candidate, which comes first. It tells how well the candidate
/// fits, and whether it can be relied on beside the others.
///
/// # Errors
/// [`Error::NoTransform`] when there is no candidate.
pub fn judge(pair: &Pair, matches: &[Match], candidates: &[Candidate]) -> Result<Registration> {
    if candidates.is_empty() {
        return Err(no_transform(pair, matches.len())?);
    }
    let counts = Matches::count(pair, matches, candidates);
    let best = &candidates[0];
    let fit = Fit::measure(pair, &best.t_target_source);
    let verdict = verdict(pair, matches, candidates, &fit, &counts)?;
    let viewpoints = pair.viewpoints();
    let report = |place: usize| CloudReport {
        viewpoint: viewpoints[place].map_or(ViewpointUsed::None, |viewpoint| viewpoint.used),
        position: viewpoints[place].map(|viewpoint| viewpoint.sensor.position),
        visible: viewpoints[place].map(|viewpoint| viewpoint.sensor.visible),
        num_skipped: pair.clouds()[place].num_skipped,
    };
    Ok(Registration {
        t_target_source: best.t_target_source,
        verdict,
        fit,
        matches: counts,
        clouds: [report(0), report(1)],
        hypotheses: candidates.iter().map(Candidate::hypothesis).collect(),
        scale: 1.0,
        seconds: 0.0,
    })
}

/// Compares a transform with the rivals that searches propose: rotations that align planes with
/// planes, slides, shifts, reflections, and motions under which a cloud is self-similar.
///
/// A rival that explains significantly more is refined and becomes the answer, which is ambiguous and no more confident.
/// A rival that explains about as much makes the registration ambiguous and not reliable: notes say what repeats, and the
/// rivals follow the best in `hypotheses`. So do an overlap of a few planes, and a part of the scene that moved as a whole if
/// the sensors would stand at one place. A mirror image that fits better also makes it not reliable.
///
/// # Errors
/// [`Error::Input`] when the points of a cloud cannot be indexed.
pub fn challenge(
    pair: &Pair,
    matches: &[Match],
    registration: &mut Registration,
    icp_steps: usize,
    control: &Control,
) -> Result<()> {
    // A confidence of 0 means an open direction, which no comparison can fix.
    if registration.verdict.confidence == 0.0 {
        return Ok(());
    }
    let transform = registration.t_target_source.isometry();
    let is_standing = are_at_one_place(pair, transform)?;
    let mut equal = rivals(pair, transform, is_standing)?;
    if let Some(better) = equal.iter().filter(|rival| rival.is_better()).max_by_key(|rival| rival.counts.gain()) {
        let mut candidates = refine(pair, matches, &[better.transform.into()], icp_steps, 1, control)?;
        candidates.push(Candidate::measure(pair, matches, &(*transform).into()));
        let (note, confidence) = (better.note(transform), registration.verdict.confidence);
        *registration = judge(pair, matches, &candidates)?;
        let verdict = &mut registration.verdict;
        verdict.confidence = verdict.confidence.min(confidence).min(MAX_DOUBTFUL);
        (verdict.is_reliable, verdict.is_ambiguous) = (false, true);
        verdict.notes.insert(0, note);
        return Ok(());
    }
    let verdict = &mut registration.verdict;
    if !(verdict.is_reliable || verdict.is_ambiguous || is_standing) {
        return Ok(());
    }
    let mut notes: Vec<String> = corner_note(pair, transform)?.into_iter().collect();
    if is_standing {
        notes.extend(together_note(pair, transform)?);
    }
    equal.retain(Rival::is_equal);
    if equal.is_empty() && notes.is_empty() {
        return Ok(());
    }
    verdict.confidence = (verdict.confidence / 2.0).min(MAX_DOUBTFUL);
    verdict.is_reliable = false;
    verdict.is_ambiguous |= !notes.is_empty() || equal.iter().any(|rival| !rival.is_mirrored());
    // Finer voxels would not tell which part moved, or which corner it is.
    let at_rest = if notes.is_empty() { 0.0 } else { 1.0 };
    verdict.notes.splice(0..0, notes);
    verdict.repeat_fit = equal.iter().map(Rival::repeat_fit).fold(at_rest, f64::max);
    // Shifts are last in the list, and notes name them first.
    verdict.notes.splice(0..0, equal.iter().rev().take(MAX_NOTES).map(|rival| rival.note(transform)));
    let rigid = equal.iter().filter(|rival| !rival.is_mirrored());
    let others = rigid.map(|rival| Candidate::measure(pair, matches, &rival.transform.into()).hypothesis());
    registration.hypotheses.splice(1..1, others);
    Ok(())
}

/// The verdict about the best candidate.
fn verdict(pair: &Pair, matches: &[Match], candidates: &[Candidate], fit: &Fit, counts: &Matches) -> Result<Verdict> {
    let best = &candidates[0];
    let transform = best.t_target_source.isometry();
    let surfaces = pair.surfaces();
    let fine = pair.fine()?;
    let overlap = overlap(fine, transform, patches::NEAR * fit.inlier_distance);
    let information = Matrix6::from_fn(|row, column| fit.information[row][column]);
    let slide_margin = slide_margin(surfaces, transform, &best.agreement, &information, fit.inlier_distance);
    let constraint = Constraint::from_overlap(&overlap, slide_margin);
    let lead = best.lead(candidates.get(1));
    let has_rival = match lead {
        Some(lead) => lead < MIN_LEAD * best.score(),
        None => {
            let agreeing = |rival: &Candidate| inliers(matches, rival.t_target_source.isometry(), pair.criteria()).0;
            let winner = (&best.agreement, counts.num_agreeing);
            let mut rivals = candidates[1..].iter().take(TRIES);
            rivals.any(|rival| is_rival((&rival.agreement, agreeing(rival)), winner))
        }
    };
    let evidence = Evidence {
        fit,
        matches: counts,
        violation: Surface::fine_violation(surfaces, transform),
        slide_margin,
        num_open: constraint.open.ncols(),
        open_motions: open_motions::names(&constraint.open),
        weakest_constraint: constraint.weakest,
        lies_apart: lies_apart(pair, transform)?,
        has_rival,
        lead,
    };
    let confidence = evidence.confidence();
    let notes = evidence.notes().into_iter().chain(units_note(pair.diameters()));
    Ok(Verdict {
        confidence,
        is_reliable: confidence >= RELIABLE,
        is_ambiguous: evidence.is_ambiguous(),
        notes: notes.chain(scale_note(surfaces, transform)).chain(left_out_notes(pair)).collect(),
        weakest_constraint: evidence.weakest_constraint,
        slide_margin: evidence.slide_margin,
        repeat_fit: 0.0,
        free_space_violation: evidence.violation,
    })
}

/// Whether a transform leaves surfaces apart, of all or of those that face along one axis: a fit is as fine as they are thin.
pub(crate) fn lies_apart(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<bool> {
    let overlap = overlap(pair.fine()?, transform, pair.criteria().inlier_distance);
    let mut axes = axes(&overlap.patches).into_iter().flatten();
    Ok(overlap.apart(None) > MAX_APART || axes.any(|axis| overlap.apart(Some(&axis)) > MAX_APART_ALONG))
}

impl Candidate {
    fn hypothesis(&self) -> Hypothesis {
        Hypothesis {
            t_target_source: self.t_target_source,
            score: self.score(),
            num_inliers: self.num_inliers,
            free_space_violation: self.free_space_violation(),
        }
    }
}

impl Fit {
    /// Measures how well the clouds of a pair fit under a transform.
    pub fn measure(pair: &Pair, t_target_source: &RigidTransform) -> Self {
        let [source, target] = pair.surfaces();
        let transform = t_target_source.isometry();
        let information = information(plane_pairs(source.points, target, transform).iter());
        let (fitness, rmse) = fitness(source.points, &target.grid, transform);
        Self {
            fitness,
            rmse,
            inlier_distance: pair.criteria().inlier_distance,
            voxel_size: pair.clouds()[1].lengths.voxel_size,
            information: std::array::from_fn(|row| std::array::from_fn(|column| information[(row, column)])),
        }
    }
}

impl Matches {
    /// Counts the matches that agree with the best candidate and with its rivals.
    fn count(pair: &Pair, matches: &[Match], candidates: &[Candidate]) -> Self {
        let best = &candidates[0];
        let agreeing: Vec<&Match> =
            matches.iter().filter(|matched| matched.agrees(&best.t_target_source, pair.criteria())).collect();
        let targets: Vec<_> = agreeing.iter().map(|matched| matched.target).collect();
        let rivals = candidates[1..].iter().take(TRIES);
        let counts = rivals.map(|rival| inliers(matches, rival.t_target_source.isometry(), pair.criteria()).0);
        let ends = |matched: &&Match| [matched.source, matched.target].map(|end| end.map(|v| v as f32).into());
        Self {
            num_matches: matches.len(),
            num_inliers: best.num_inliers,
            rmse: best.rmse,
            num_agreeing: agreeing.len(),
            num_rival_agreeing: counts.max().unwrap_or(0),
            spread: least_spread(&targets),
            pairs: agreeing.iter().map(ends).collect(),
        }
    }
}

/// Notes on the missing returns and the outliers of the clouds, which were left out.
fn left_out_notes(pair: &Pair) -> impl Iterator<Item = String> {
    let named = pair.clouds().into_iter().zip(["source", "target"]);
    named.flat_map(|(cloud, name)| {
        let missing = cloud.missing.iter().map(|words| format!("{words}; they are left out"));
        missing.chain(cloud.outliers.map(|outliers| outliers.to_string())).map(move |words| format!("{name}: {words}"))
    })
}

/// A question about the units, if the clouds' sizes differ much.
pub(crate) fn units_note(diameters: [f64; 2]) -> Option<String> {
    let ratio = diameters[0].max(diameters[1]) / diameters[0].min(diameters[1]);
    (ratio > UNIT_RATIO)
        .then(|| format!("one cloud is {ratio:.0} times as large as the other; are the units the same?"))
}

/// The error of a pair without a transform.
fn no_transform(pair: &Pair, num_matches: usize) -> Result<Error> {
    let [source, target] = pair.clouds().map(|cloud| cloud.voxels.voxels.points.len());
    let [source_diameter, target_diameter] = pair.diameters();
    let mut reason = format!(
        "no three of the {num_matches} correspondences, of {source} and {target} voxels, fit a rigid transform; do \
         the clouds overlap, and in the same units? their diameters are {source_diameter:.4} and {target_diameter:.4}"
    );
    // If the clouds have different units, the voxels are too large for normals. One note is enough:
    // an error is one short line.
    let note = units_note(pair.diameters()).map_or_else(|| open_alone(pair), |note| Ok(Some(note)))?;
    if let Some(note) = note {
        reason += &format!("; {note}");
    }
    Ok(Error::NoTransform { reason })
}

/// A note on the first of the clouds that can move along its own surface.
fn open_alone(pair: &Pair) -> Result<Option<String>> {
    let distance = patches::NEAR * pair.criteria().inlier_distance;
    for (fine, name) in pair.fine()?.into_iter().zip(["source", "target"]) {
        let overlap = overlap([fine, fine], &IsometryMatrix3::identity(), distance);
        let open = Constraint::from_patches(&overlap.patches).open;
        if open.ncols() > 0 {
            return Ok(Some(format!("the {name} can move along its own surface ({})", open_motions::names(&open))));
        }
    }
    Ok(None)
}

/// Lowers the confidence of the result of a further try: one of two wrong results looks right by
/// chance twice as often as a single one.
pub(crate) fn less_confident(mut registration: Registration) -> Registration {
    let verdict = &mut registration.verdict;
    verdict.confidence /= 2.0 - verdict.confidence;
    if verdict.is_reliable && verdict.confidence < RELIABLE {
        verdict.notes.push("not reliable: of two searches one looks right by chance twice as often".into());
    }
    verdict.is_reliable = verdict.confidence >= RELIABLE;
    registration
}
