//! The figures of the 3DMatch benchmark, for every detector and descriptor.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use snake_core::metrics::{
    RegistrationOutcome, feature_matching_recall, information_matrix, inlier_ratio, overlap, registration_recall,
    squared_registration_error,
};
use snake_core::registration::{Descriptor, KeypointDetector, RansacOptions, Scan, mutual_nearest, ransac};
use snake_core::{Model, Point, io};

use super::record::{Pair, Record};
use super::scenes::{ScenePair, Scenes};
use super::table::{self, Table};
use super::{complete, evenly_spaced, set_threads};
use crate::args::RegistrationArguments;
use crate::model;

/// What the benchmark fixes, in metres: clouds are reduced to voxels of this size,
const VOXEL_SIZE: f64 = 0.03;
/// correspondences are right within this distance,
const INLIER_DISTANCE: f64 = 0.1;
/// a pair matches if more than this share of them is right,
const INLIER_RATIO: f64 = 0.05;
/// RANSAC counts those nearer than this,
const RANSAC_DISTANCE: f64 = 0.05;
/// takes at most this many samples,
const RANSAC_SAMPLES: usize = 50_000;
/// and a pair is registered up to this RMSE.
const RMSE: f64 = 0.2;
/// Where there is no gt.info, points overlap that are nearer than this.
const OVERLAP_DISTANCE: f64 = 0.05;

/// Evaluates every pair that is not yet recorded, then reports.
pub fn registration(arguments: &RegistrationArguments) -> Result<()> {
    set_threads(arguments.threads)?;
    let scenes = Scenes::open(&arguments.data)?;
    let model = model::load(arguments.model.as_deref())?;
    let plan = Plan::new(arguments, &model)?;
    let chosen = evenly_spaced(scenes.pairs.len(), arguments.limit)?;
    let settings = plan.settings(arguments);
    let mut record = Record::open(arguments.output.as_deref(), "registration", &settings, chosen.len())?;
    let mut clouds = Clouds::default();
    let rows = |pair| {
        let pair: &ScenePair = &scenes.pairs[pair];
        let [source, target] = clouds.of(pair, &scenes.clouds, &plan)?;
        plan.rows(pair, source, target)
    };
    complete(&mut record, &chosen, |pair| scenes.name(pair), rows)?;
    let pairs: Vec<&ScenePair> = chosen.iter().map(|&pair| &scenes.pairs[pair]).collect();
    let report = Report::new(&plan, &settings, &pairs, record.pairs())?;
    if let Some(output) = &arguments.output {
        table::write(output, "registration", &report.csv(), &report.json(), &report.tables())?;
    }
    crate::print(&table::text(&report.tables()))
}

/// What is measured.
struct Plan<'a> {
    model: &'a Model,
    detectors: &'a [KeypointDetector],
    descriptors: &'a [Descriptor],
    keypoints: &'a [usize],
    seed: u64,
}

/// The figures of one detector, descriptor and number of keypoints on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Row {
    /// Keypoints that there were, mean of both clouds.
    found: f64,
    correspondences: usize,
    inlier_ratio: f64,
    /// In square metres; `None` if no transform was found.
    squared_error: Option<f64>,
}

impl<'a> Plan<'a> {
    fn new(arguments: &'a RegistrationArguments, model: &'a Model) -> Result<Self> {
        let RegistrationArguments { detectors, descriptors, keypoints, seed, .. } = arguments;
        if keypoints.contains(&0) {
            bail!("--keypoints must be 1 or more");
        }
        Ok(Self { model, detectors, descriptors, keypoints, seed: *seed })
    }

    /// Everything that the figures depend on, but for the data's content.
    fn settings(&self, arguments: &RegistrationArguments) -> Value {
        json!({
            "metric": "registration",
            "data": arguments.data,
            "limit": arguments.limit,
            "detectors": self.detectors,
            "descriptors": self.descriptors,
            "keypoints": self.keypoints,
            "model": self.model.metadata(),
            "voxel_size": VOXEL_SIZE,
            "inlier_distance": INLIER_DISTANCE,
            "inlier_ratio": INLIER_RATIO,
            "overlap_distance": OVERLAP_DISTANCE,
            "ransac": self.ransac(),
            "rmse": RMSE,
        })
    }

    fn ransac(&self) -> RansacOptions {
        let (inlier_distance, max_iterations) = (RANSAC_DISTANCE, RANSAC_SAMPLES);
        RansacOptions { inlier_distance, max_iterations, seed: self.seed, ..RansacOptions::default() }
    }

    /// Detector, descriptor and number of keypoints of each row of a pair.
    fn cases(&self) -> Vec<(KeypointDetector, Descriptor, usize)> {
        let mut cases = Vec::new();
        for &detector in self.detectors {
            for &descriptor in self.descriptors {
                cases.extend(self.keypoints.iter().map(|&keypoints| (detector, descriptor, keypoints)));
            }
        }
        cases
    }

    /// Reads a cloud, and describes as many keypoints of each detector as are needed.
    fn cloud(&self, files: &[PathBuf], index: usize) -> Result<Cloud> {
        let points = io::read_points(&files[index])?;
        let scan = Scan::new(&points, self.model, VOXEL_SIZE)?;
        let most = self.keypoints.iter().copied().max().unwrap_or_default();
        // Random keypoints of two clouds have nothing to do with each other.
        let seed = self.seed.wrapping_add(index as u64);
        let mut features = Vec::new();
        for &detector in self.detectors {
            let keypoints = scan.keypoints(detector, most, seed)?;
            for &descriptor in self.descriptors {
                let (keypoints, dimension) = (keypoints.clone(), scan.dimension(descriptor));
                let descriptors = scan.descriptors(&keypoints, descriptor)?;
                features.push(Features { keypoints, descriptors, dimension });
            }
        }
        Ok(Cloud { points, features })
    }

    /// The figures of one pair: a row for each case.
    fn rows(&self, pair: &ScenePair, source: &Cloud, target: &Cloud) -> Result<Vec<Row>> {
        let truth = &pair.t_target_source;
        let information = match pair.information {
            Some(information) => information,
            None => information_matrix(&overlap(&source.points, &target.points, truth, OVERLAP_DISTANCE)?)
                .context("the clouds do not overlap under the given transform")?,
        };
        let mut rows = Vec::new();
        for (source, target) in source.features.iter().zip(&target.features) {
            for &count in self.keypoints {
                let [(source_points, source_rows), (target_points, target_rows)] =
                    [source.best(count), target.best(count)];
                let matches = mutual_nearest(source_rows, target_rows, source.dimension)?;
                let from: Vec<Point> = matches.iter().map(|&[row, _]| source_points[row]).collect();
                let to: Vec<Point> = matches.iter().map(|&[_, row]| target_points[row]).collect();
                let found = ransac(&from, &to, &self.ransac())?;
                let squared_error =
                    found.map(|found| squared_registration_error(truth, &found.t_target_source, &information));
                rows.push(Row {
                    found: (source_points.len() + target_points.len()) as f64 / 2.0,
                    correspondences: matches.len(),
                    inlier_ratio: inlier_ratio(&from, &to, truth, INLIER_DISTANCE)?,
                    squared_error: squared_error.transpose()?,
                });
            }
        }
        Ok(rows)
    }
}

/// A cloud with its keypoints by each detector and descriptor.
struct Cloud {
    points: Vec<Point>,
    features: Vec<Features>,
}

/// Keypoints, the best first, with a row of `dimension` numbers each.
struct Features {
    keypoints: Vec<Point>,
    descriptors: Vec<f32>,
    dimension: usize,
}

impl Features {
    /// The first `count`, or all.
    fn best(&self, count: usize) -> (&[Point], &[f32]) {
        let count = count.min(self.keypoints.len());
        (&self.keypoints[..count], &self.descriptors[..count * self.dimension])
    }
}

/// The clouds of the scene at hand.
#[derive(Default)]
struct Clouds {
    scene: String,
    described: HashMap<usize, Cloud>,
}

impl Clouds {
    /// Source and target of a pair.
    fn of(&mut self, pair: &ScenePair, files: &[PathBuf], plan: &Plan) -> Result<[&Cloud; 2]> {
        if self.scene != pair.scene {
            self.scene.clone_from(&pair.scene);
            self.described.clear();
        }
        for index in [pair.source, pair.target] {
            if let Entry::Vacant(vacant) = self.described.entry(index) {
                let cloud = plan.cloud(files, index).with_context(|| files[index].display().to_string())?;
                vacant.insert(cloud);
            }
        }
        Ok([&self.described[&pair.source], &self.described[&pair.target]])
    }
}

/// The figures of every case.
struct Report<'a> {
    settings: &'a Value,
    keypoints: &'a [usize],
    scenes: Vec<&'a str>,
    num_pairs: usize,
    summaries: Vec<Summary>,
}

/// The figures of one case, of each scene and their mean.
struct Summary {
    detector: Value,
    descriptor: Value,
    keypoints: usize,
    scenes: Vec<Figures>,
    mean: Figures,
}

/// The figures of one case.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Figures {
    feature_matching_recall: f64,
    inlier_ratio: f64,
    /// `None` of nothing but consecutive fragments.
    registration_recall: Option<f64>,
    /// Keypoints that there were, and their correspondences, means over the pairs.
    found: f64,
    correspondences: f64,
}

impl Figures {
    /// Of the pairs of one scene.
    fn of_scene(pairs: &[(&ScenePair, &Row)]) -> Result<Self> {
        let ratios: Vec<f64> = pairs.iter().map(|(_, row)| row.inlier_ratio).collect();
        let outcome = |(pair, row): &(&ScenePair, &Row)| {
            let [first, second] = pair.fragments;
            RegistrationOutcome { first, second, squared_error: row.squared_error }
        };
        let outcomes: Vec<_> = pairs.iter().map(outcome).collect();
        Ok(Self {
            feature_matching_recall: feature_matching_recall(&ratios, INLIER_RATIO)?,
            inlier_ratio: mean(ratios.iter().copied()),
            // Its only error is that no pair is left.
            registration_recall: registration_recall(&outcomes, RMSE).ok(),
            found: mean(pairs.iter().map(|(_, row)| row.found)),
            correspondences: mean(pairs.iter().map(|(_, row)| row.correspondences as f64)),
        })
    }

    /// The plain mean over the scenes.
    fn mean(scenes: &[Self]) -> Self {
        let of = |figure: fn(&Self) -> f64| mean(scenes.iter().map(figure));
        let recalls: Vec<f64> = scenes.iter().filter_map(|scene| scene.registration_recall).collect();
        Self {
            feature_matching_recall: of(|scene| scene.feature_matching_recall),
            inlier_ratio: of(|scene| scene.inlier_ratio),
            registration_recall: (!recalls.is_empty()).then(|| mean(recalls.iter().copied())),
            found: of(|scene| scene.found),
            correspondences: of(|scene| scene.correspondences),
        }
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

impl<'a> Report<'a> {
    /// Sums up the rows of all pairs, of which there is at least one.
    fn new(plan: &'a Plan, settings: &'a Value, pairs: &[&'a ScenePair], rows: &[Pair<Row>]) -> Result<Self> {
        let mut scenes: Vec<&str> = Vec::new();
        for pair in pairs {
            if !scenes.contains(&pair.scene.as_str()) {
                scenes.push(&pair.scene);
            }
        }
        let summary = |(i, (detector, descriptor, keypoints)): (usize, (KeypointDetector, Descriptor, usize))| {
            let of_scene = |scene: &&str| {
                let rows = pairs.iter().zip(rows).filter(|(pair, _)| pair.scene == *scene);
                Figures::of_scene(&rows.map(|(pair, rows)| (*pair, &rows.rows[i])).collect::<Vec<_>>())
            };
            let scenes = scenes.iter().map(of_scene).collect::<Result<Vec<_>>>()?;
            let mean = Figures::mean(&scenes);
            Ok(Summary { detector: json!(detector), descriptor: json!(descriptor), keypoints, scenes, mean })
        };
        let summaries = plan.cases().into_iter().enumerate().map(summary).collect::<Result<_>>()?;
        Ok(Self { settings, keypoints: plan.keypoints, scenes, num_pairs: pairs.len(), summaries })
    }

    /// Of each figure a table: a row for each detector and descriptor, a column for each number of keypoints.
    fn tables(&self) -> Vec<Table> {
        let (pairs, scenes) = (self.num_pairs, self.scenes.len());
        let titled = |title: String, cell: fn(&Figures) -> String| {
            let mut head = vec!["keypoints".to_owned()];
            head.extend(self.keypoints.iter().map(usize::to_string));
            let row = |cases: &[Summary]| {
                let name = |value: &Value| value.as_str().unwrap_or_default().to_owned();
                let method = name(&cases[0].detector) + " " + &name(&cases[0].descriptor);
                std::iter::once(method).chain(cases.iter().map(|case| cell(&case.mean))).collect()
            };
            Table { title, head, rows: self.summaries.chunks(self.keypoints.len()).map(row).collect() }
        };
        vec![
            titled(format!("Feature matching recall, {pairs} pairs, mean over scenes ({scenes})"), |figures| {
                format!("{:.3}", figures.feature_matching_recall)
            }),
            titled("Inlier ratio".into(), |figures| format!("{:.3}", figures.inlier_ratio)),
            titled("Registration recall, without consecutive fragments".into(), |figures| {
                figures.registration_recall.map_or("-".into(), |recall| format!("{recall:.3}"))
            }),
            titled("Keypoints / correspondences, means over the pairs".into(), |figures| {
                format!("{:.0} / {:.0}", figures.found, figures.correspondences)
            }),
        ]
    }

    /// A line for each case and scene, and one for the mean over the scenes.
    fn csv(&self) -> String {
        let mut text = String::from(
            "detector,descriptor,keypoints,scene,feature_matching_recall,inlier_ratio,registration_recall,found,correspondences\n",
        );
        for Summary { detector, descriptor, keypoints, scenes, mean } in &self.summaries {
            let quoted = self.scenes.iter().map(|scene| format!("\"{}\"", scene.replace('"', "\"\"")));
            for (scene, figures) in quoted.zip(scenes).chain(std::iter::once(("mean".into(), mean))) {
                let Figures { feature_matching_recall, inlier_ratio, registration_recall, found, correspondences } =
                    figures;
                let recall = registration_recall.map(|recall| recall.to_string()).unwrap_or_default();
                let (detector, descriptor) =
                    (detector.as_str().unwrap_or_default(), descriptor.as_str().unwrap_or_default());
                text += &format!(
                    "{detector},{descriptor},{keypoints},{scene},{feature_matching_recall},{inlier_ratio},{recall},{found},{correspondences}\n"
                );
            }
        }
        text
    }

    fn json(&self) -> Value {
        let row = |summary: &Summary| {
            let Summary { detector, descriptor, keypoints, scenes, mean } = summary;
            json!({"detector": detector, "descriptor": descriptor, "keypoints": keypoints, "mean": mean, "scenes": scenes})
        };
        let rows: Vec<Value> = self.summaries.iter().map(row).collect();
        json!({"settings": self.settings, "pairs": self.num_pairs, "scenes": self.scenes, "rows": rows})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(scene: &str, fragments: [usize; 2]) -> ScenePair {
        let t_target_source = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
        ScenePair { scene: scene.into(), source: 0, target: 1, fragments, t_target_source, information: None }
    }

    fn row(inlier_ratio: f64, squared_error: Option<f64>) -> Pair<Row> {
        let row = Row { found: 50.0, correspondences: 10, inlier_ratio, squared_error };
        Pair { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn figures_are_means_over_the_scenes_by_hand() {
        let model = Model::builtin().unwrap();
        let (detectors, descriptors) = ([KeypointDetector::Iss], [Descriptor::Fpfh]);
        let plan = Plan { model: &model, detectors: &detectors, descriptors: &descriptors, keypoints: &[100], seed: 0 };
        // Scene a has three pairs, one of them consecutive and one without a transform; b only a consecutive one.
        let pairs = [pair("a", [0, 1]), pair("a", [0, 2]), pair("a", [0, 3]), pair("b", [4, 5])];
        let rows = [row(0.5, None), row(0.04, Some(0.03)), row(0.06, None), row(0.0, Some(0.0))];
        let settings = json!({"seed": 0});
        let report = Report::new(&plan, &settings, &pairs.each_ref(), &rows).unwrap();
        let csv = report.csv();
        let lines: Vec<&str> = csv.lines().skip(1).collect();
        let a = format!("iss,fpfh,100,\"a\",{},{},0.5,50,10", 2.0 / 3.0, (0.5 + 0.04 + 0.06) / 3.0);
        assert_eq!(lines[..2], [&a[..], "iss,fpfh,100,\"b\",0,0,,50,10"]);
        assert!(lines[2].starts_with(&format!("iss,fpfh,100,mean,{},", 1.0 / 3.0)) && lines[2].ends_with(",0.5,50,10"));
        let markdown = table::markdown(&report.tables());
        let expected = "Registration recall, without consecutive fragments:

| keypoints | 100 |
|---|---|
| iss fpfh | 0.500 |
";
        assert!(markdown.contains(expected), "{markdown}");
        assert!(markdown.contains("4 pairs, mean over scenes (2)") && markdown.contains("| 50 / 10 |"), "{markdown}");
        assert_eq!(report.json()["rows"][0]["scenes"][1]["registration_recall"], Value::Null);
    }
}
