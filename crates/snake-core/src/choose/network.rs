//! Small networks that weigh the signs of a scene; `python -m snake_training.cloud_kind` fits them.

use std::sync::OnceLock;

use serde::Deserialize;

use crate::cloud::NUM_SIGNS;

/// Signs are weighed up to so many deviations from their mean.
const LIMIT: f64 = 3.0;

/// Networks whose mean counts. Each has layers of rows: the weights of the inputs, and a constant at the end.
#[derive(Deserialize)]
pub(super) struct Networks {
    mean: [f64; NUM_SIGNS],
    deviation: [f64; NUM_SIGNS],
    networks: Vec<Vec<Vec<Vec<f64>>>>,
}

impl Networks {
    /// The networks of this release.
    pub fn fitted() -> &'static Self {
        static FITTED: OnceLock<Networks> = OnceLock::new();
        FITTED.get().unwrap_or_else(|| {
            // Read before the cell is locked: a child process that is forked meanwhile would find it locked forever.
            let read = serde_json::from_str(include_str!("kind.json")).expect("the file is part of the program");
            FITTED.get_or_init(|| read)
        })
    }

    /// The log-odds that a cloud with these signs is a scene.
    pub fn score(&self, signs: &[f64; NUM_SIGNS]) -> f64 {
        let scaled = |i: usize| ((signs[i] - self.mean[i]) / self.deviation[i]).clamp(-LIMIT, LIMIT);
        let scaled: Vec<f64> = (0..NUM_SIGNS).map(scaled).collect();
        let score = |layers: &Vec<Vec<Vec<f64>>>| {
            let mut values = scaled.clone();
            for (number, layer) in layers.iter().enumerate() {
                if number > 0 {
                    values.iter_mut().for_each(|value| *value /= 1.0 + value.abs());
                }
                values.push(1.0);
                let sum = |row: &Vec<f64>| row.iter().zip(&values).map(|(weight, value)| weight * value).sum();
                values = layer.iter().map(sum).collect();
            }
            values[0]
        };
        self.networks.iter().map(score).sum::<f64>() / self.networks.len() as f64
    }
}
