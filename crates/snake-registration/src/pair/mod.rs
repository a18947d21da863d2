//! The registration of two prepared clouds.

pub(crate) mod consistency;
pub(crate) mod describe;
pub(crate) mod fine;
pub(crate) mod icp;
pub(crate) mod match_graph;
pub(crate) mod model;
pub(crate) mod prepared;
pub(crate) mod register;
pub(crate) mod scan;
pub(crate) mod sentinels;
pub(crate) mod surface;
pub(crate) mod viewpoint;

use std::time::Instant;

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use snake_core::{Control, Error, Result};
use snake_geometry::{Outliers, Vector, vector};

use crate::options::RegisterOptions;
use crate::pair::consistency::{displacement, hypotheses};
use crate::pair::fine::{FineCloud, overlap, refine_finely};
use crate::pair::icp::{icp, information, plane_pairs, symmetric_icp};
use crate::pair::match_graph::{Criteria, Match};
use crate::pair::prepared::Prepared;
use crate::pair::surface::{Agreement, Surface, coarse_step, fitness};
use crate::parts::matching::ranked_matches;
use crate::parts::spread::least_spread;
use crate::result::{Hypothesis, Registration, ViewpointUsed};
use crate::verdict::constraint::Constraint;
use crate::verdict::open_motions;
use crate::verdict::repeats::repeated_share;
use crate::verdict::slide::slide_margin;
use crate::verdict::{Evidence, REPEATED_FITNESS, is_rival, notes, units_note};

/// Number of transforms that are compared on the voxels.
const CANDIDATES: usize = 20;
/// ICP steps before the comparison.
const COARSE_STEPS: usize = 5;
/// Number of transforms that are refined on all voxels, at least.
const REFINED: usize = 3;
/// A guess is first refined with pairs up to this many inlier distances apart.
const WIDE: f64 = 4.0;
/// Patches of both clouds are one if they are closer than this many inlier distances.
const PATCH_DISTANCE: f64 = 0.5;
/// Greatest share of the overlap with opposite normals if the sensors were at the origins. Of scans it is 0.05 and less, of
/// simulated sweeps 0.14, and of objects around the origin 0.2 to 0.5.
const MOST_OPPOSED: f64 = 0.15;

/// Two prepared clouds.
pub(crate) struct Pair<'a> {
    /// Source and target.
    clouds: [&'a Prepared; 2],
    /// Whether the normals of both have a sign.
    signed: bool,
    inlier_distance: f64,
}

/// A transform after ICP.
struct Candidate {
    refined: IsometryMatrix3<f64>,
    agreement: Agreement,
    /// Number of matches that agreed with the transform before ICP, and their root mean square distance.
    num_inliers: usize,
    rmse: f64,
}

impl Candidate {
    fn score(&self) -> f64 {
        self.agreement.score(self.num_inliers)
    }
}

impl<'a> Pair<'a> {
    pub(crate) fn new(source: &'a Prepared, target: &'a Prepared, inlier_distance: f64) -> Self {
        let signed = source.viewpoint.is_some() && target.viewpoint.is_some();
        Self { clouds: [source, target], signed, inlier_distance }
    }

    /// The best transform with figures of its quality, once its clouds are prepared.
    pub(crate) fn register(&self, options: &RegisterOptions, control: &Control) -> Result<Registration> {
        let start = Instant::now();
        let (matches, found) = self.search(options, control)?;
        if !self.contradicts_guessed_viewpoints(&found[0].refined) {
            return self.report(&matches, &found, options, start);
        }
        let unsigned = Self { signed: false, ..*self };
        let (matches, found) = unsigned.search(options, control)?;
        unsigned.report(&matches, &found, options, start)
    }

    /// The matches and the transforms, best first; there is at least one.
    fn search(&self, options: &RegisterOptions, control: &Control) -> Result<(Vec<Match>, Vec<Candidate>)> {
        let matches = self.matches(options, control)?;
        let guesses = match options.initial {
            Some(guess) => vec![self.refine_widely(guess.isometry(), options, control)?],
            None => hypotheses(&matches, &self.criteria(options), CANDIDATES, control)?,
        };
        let found = self.best(&guesses, &matches, options, control)?;
        if found.is_empty() { Err(self.no_transform(matches.len())?) } else { Ok((matches, found)) }
    }

    /// Whether a sensor was taken to be at the origin of a cloud, and opposite normals on the overlap show that it was not.
    fn contradicts_guessed_viewpoints(&self, transform: &IsometryMatrix3<f64>) -> bool {
        let [source, target] = &self.surfaces();
        self.viewpoints_used().contains(&ViewpointUsed::Origin)
            && Surface::opposed(source, target, transform) > MOST_OPPOSED
    }

    /// The best of the transforms found, with figures of its quality.
    fn report(
        &self,
        matches: &[Match],
        found: &[Candidate],
        options: &RegisterOptions,
        start: Instant,
    ) -> Result<Registration> {
        let best = &found[0];
        let surfaces = self.surfaces();
        let fine = self.fine()?;
        let overlap = overlap(fine, &best.refined, PATCH_DISTANCE * self.inlier_distance);
        let information = information(plane_pairs(surfaces[0].points, &surfaces[1], &best.refined).iter());
        let slide_margin = slide_margin(&surfaces, &best.refined, &best.agreement, &information, self.inlier_distance);
        let constraint = Constraint::of(&overlap, slide_margin);
        let criteria = self.criteria(options);
        let rivals = &found[1..found.len().min(REFINED)];
        let agreeing = |candidate: &Candidate| inliers(matches, &candidate.refined, &criteria).0;
        let agreed: Vec<&Match> =
            matches.iter().filter(|found| found.squared_residual(&best.refined, &criteria).is_some()).collect();
        let match_spread = least_spread(&agreed.iter().map(|found| found.target).collect::<Vec<_>>());
        let num_agreeing = agreed.len();
        let of_rivals: Vec<usize> = rivals.iter().map(agreeing).collect();
        let mut counted = rivals.iter().zip(&of_rivals);
        let (fitness, fitness_rmse) = fitness(surfaces[0].points, &surfaces[1].grid, &best.refined);
        let evidence = Evidence {
            violation: Surface::fine_violation(&surfaces, &best.refined),
            match_spread: match_spread / self.inlier_distance,
            num_agreeing,
            num_rival_agreeing: of_rivals.iter().copied().max().unwrap_or(0),
            slide_margin,
            open_directions: (constraint.open.ncols(), open_motions::names(&constraint.open)),
            weakest_constraint: constraint.weakest,
            repeat_fit: match fitness > REPEATED_FITNESS {
                true => repeated_share(&overlap.patches, fine[1], &surfaces[1]),
                false => 0.0,
            },
            fitness,
            coinciding: overlap.coinciding(fine, self.clouds[0].scan.voxel_size),
            has_rival: counted
                .any(|(rival, count)| is_rival((&rival.agreement, *count), (&best.agreement, num_agreeing))),
        };
        let confidence = evidence.confidence();
        let hypothesis = |candidate: &Candidate| Hypothesis {
            t_target_source: candidate.refined.into(),
            score: candidate.score(),
            num_inliers: candidate.num_inliers,
            free_space_violation: candidate.agreement.violation,
        };
        Ok(Registration {
            t_target_source: best.refined.into(),
            confidence,
            is_reliable: confidence >= 0.5,
            is_ambiguous: evidence.is_ambiguous(),
            num_inliers: best.num_inliers,
            num_agreeing: evidence.num_agreeing,
            num_rival_agreeing: evidence.num_rival_agreeing,
            num_correspondences: matches.len(),
            rmse: best.rmse,
            inlier_distance: self.inlier_distance,
            fitness,
            fitness_rmse,
            free_space_violation: evidence.violation,
            match_spread,
            slide_margin: evidence.slide_margin,
            repeat_fit: evidence.repeat_fit,
            weakest_constraint: evidence.weakest_constraint,
            information: std::array::from_fn(|row| std::array::from_fn(|column| information[(row, column)])),
            hypotheses: found.iter().take(options.hypotheses).map(hypothesis).collect(),
            matches: agreed
                .iter()
                .map(|found| [found.source, found.target].map(|end| end.map(|v| v as f32).into()))
                .collect(),
            viewpoints: self.viewpoints_used(),
            notes: self.sentinel_notes().chain(notes(&evidence, self.diameters())).chain(self.outliers()).collect(),
            num_skipped: self.clouds.map(|cloud| cloud.num_skipped),
            seconds: start.elapsed().as_secs_f64(),
        })
    }

    /// What was left out of the clouds, in words.
    fn sentinel_notes(&self) -> impl Iterator<Item = String> {
        let named = self.clouds.into_iter().zip(["source", "target"]);
        named.flat_map(|(cloud, name)| {
            cloud.sentinels.iter().map(move |words| format!("{name}: {words}; they are left out"))
        })
    }

    fn criteria(&self, options: &RegisterOptions) -> Criteria {
        let Self { inlier_distance, signed, .. } = *self;
        Criteria { inlier_distance, signed, gravity: options.gravity.map(|axis| axis.unit()) }
    }

    /// The outliers of the clouds, which were left out.
    fn outliers(&self) -> impl Iterator<Item = String> + use<> {
        let [source, target] = self.clouds.map(|cloud| cloud.outliers);
        let named = |(name, outliers): (&str, Option<Outliers>)| outliers.map(|outliers| format!("{name}: {outliers}"));
        [("source", source), ("target", target)].into_iter().filter_map(named)
    }

    fn diameters(&self) -> [f64; 2] {
        self.clouds.map(|cloud| cloud.diameter)
    }

    fn viewpoints_used(&self) -> [ViewpointUsed; 2] {
        let used = |cloud: &Prepared| cloud.viewpoint.filter(|_| self.signed).map(|(_, used)| used);
        self.clouds.map(|cloud| used(cloud).unwrap_or(ViewpointUsed::None))
    }

    fn surfaces(&self) -> [Surface<'a>; 2] {
        self.surfaces_within(self.inlier_distance)
    }

    fn surfaces_within(&self, distance: f64) -> [Surface<'a>; 2] {
        self.clouds.map(|cloud| cloud.surface(self.signed, distance))
    }

    /// Matches of keypoints, the most distinctive first.
    fn matches(&self, options: &RegisterOptions, control: &Control) -> Result<Vec<Match>> {
        let [source, target] = self.clouds;
        let descriptors = [source, target].map(|cloud| cloud.descriptors(self.signed, control));
        let [source_descriptors, target_descriptors] = descriptors;
        let dimension = source.dimension;
        let count = options.max_matches;
        let ranked = ranked_matches(source_descriptors?, target_descriptors?, dimension, count, control)?;
        let matched = |[s, t]: [usize; 2]| Match {
            source: vector(source.keypoints[s].0),
            target: vector(target.keypoints[t].0),
            source_normal: source.scan.normals[source.keypoints[s].1],
            target_normal: target.scan.normals[target.keypoints[t].1],
        };
        Ok(ranked.into_iter().map(matched).collect())
    }

    /// The best of the transforms, refined, best first and distinct.
    fn best(
        &self,
        guesses: &[IsometryMatrix3<f64>],
        matches: &[Match],
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Vec<Candidate>> {
        let surfaces = self.surfaces();
        let [source, target] = &surfaces;
        let criteria = self.criteria(options);
        let counter = control.begin("ICP", guesses.len());
        let step = coarse_step(source.points.len());
        let coarse: Vec<Vector> = source.points.iter().step_by(step).copied().collect();
        let candidates = guesses.par_iter().map(|rough| {
            counter.add(1);
            let steps = COARSE_STEPS.min(options.refine_steps);
            let refined = icp(&coarse, target, *rough, criteria.gravity, steps, &counter)?;
            let agreement = Surface::agreement(source, target, &refined, step);
            let (num_inliers, rmse) = inliers(matches, rough, &criteria);
            Ok(Candidate { refined, agreement, num_inliers, rmse })
        });
        let mut candidates: Vec<Candidate> = candidates.collect::<Result<_>>()?;
        sort(&mut candidates);
        // Otherwise the best few may all be one transform, and a rival is not seen.
        let mut candidates = self.distinct(candidates, &coarse);
        candidates.truncate(REFINED.max(options.hypotheses));
        for candidate in &mut candidates {
            let (rough, steps) = (candidate.refined, options.refine_steps);
            candidate.refined = symmetric_icp(&surfaces, rough, criteria.gravity, steps, &counter)?;
            candidate.agreement = Surface::agreement(source, target, &candidate.refined, 1);
        }
        sort(&mut candidates);
        let mut found = self.distinct(candidates, &coarse);
        if let Some(best) = found.first_mut()
            && options.refine_steps > 0
        {
            let refined = refine_finely(self.fine()?, best.refined, criteria.gravity, &counter)?;
            if displacement(&refined, &best.refined, &coarse) < self.inlier_distance {
                best.refined = refined;
            }
        }
        Ok(found)
    }

    /// The candidates without those that move the points to about the same places as a better one.
    fn distinct(&self, candidates: Vec<Candidate>, points: &[Vector]) -> Vec<Candidate> {
        let mut distinct: Vec<Candidate> = Vec::new();
        for candidate in candidates {
            let apart = |other: &Candidate| displacement(&candidate.refined, &other.refined, points);
            if distinct.iter().all(|other| apart(other) > 2.0 * self.inlier_distance) {
                distinct.push(candidate);
            }
        }
        distinct
    }

    /// A guess after ICP with distant pairs.
    fn refine_widely(
        &self,
        guess: &IsometryMatrix3<f64>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<IsometryMatrix3<f64>> {
        let mut transform = *guess;
        for factor in [WIDE, WIDE.sqrt()] {
            let [source, target] = self.surfaces_within(factor * self.inlier_distance);
            let counter = control.begin("ICP", 0);
            let gravity = options.gravity.map(|axis| axis.unit());
            transform = icp(source.points, &target, transform, gravity, options.refine_steps, &counter)?;
        }
        Ok(transform)
    }

    /// Notes on clouds that can move along their own surface.
    fn open_alone(&self) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        for (fine, name) in self.fine()?.into_iter().zip(["source", "target"]) {
            let overlap = overlap([fine, fine], &IsometryMatrix3::identity(), PATCH_DISTANCE * self.inlier_distance);
            let open = Constraint::new(&overlap.patches).open;
            if open.ncols() > 0 {
                notes.push(format!("the {name} can move along its own surface ({})", open_motions::names(&open)));
            }
        }
        Ok(notes)
    }

    fn fine(&self) -> Result<[&'a FineCloud; 2]> {
        let [source, target] = self.clouds;
        Ok([source.fine()?, target.fine()?])
    }

    fn no_transform(&self, num_matches: usize) -> Result<Error> {
        let [source, target] = self.clouds.map(|cloud| cloud.scan.voxels.points.len());
        let [source_diameter, target_diameter] = self.diameters();
        let mut reason = format!(
            "no three of the {num_matches} correspondences, of {source} and {target} voxels, fit a rigid transform; do \
             the clouds overlap, and in the same units? their diameters are {source_diameter:.4} and {target_diameter:.4}"
        );
        // The voxels of clouds in different units are too large for normals.
        let notes = units_note(self.diameters()).map_or_else(|| self.open_alone(), |note| Ok(vec![note]))?;
        // One is enough: an error is one short line.
        if let Some(note) = notes.first() {
            reason += &format!("; {note}");
        }
        Ok(Error::NoTransform { reason })
    }
}

/// Best first; the order decides between equals.
fn sort(candidates: &mut [Candidate]) {
    candidates.sort_by(|a, b| b.score().total_cmp(&a.score()));
}

/// Number and root mean square distance of the matches that agree with a transform.
fn inliers(matches: &[Match], transform: &IsometryMatrix3<f64>, criteria: &Criteria) -> (usize, f64) {
    let squared = matches.iter().filter_map(|found| found.squared_residual(transform, criteria));
    let (count, sum) = squared.fold((0, 0.0), |(count, sum), squared| (count + 1, sum + squared));
    (count, (sum / count.max(1) as f64).sqrt())
}
