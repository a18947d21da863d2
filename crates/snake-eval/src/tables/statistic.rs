//! Means with their standard deviations.

/// A mean with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistic {
    /// The mean; NaN where there is no figure.
    pub mean: f64,
    /// Sample standard deviation (n - 1); `None` for a single value.
    pub deviation: Option<f64>,
}

impl Statistic {
    /// The mean and deviation of one figure for each seed. A single seed has the deviation over its parts, which are
    /// pairs, shapes or scenes.
    pub fn over_seeds(figures: &[f64], parts: &[f64]) -> Self {
        match figures {
            [mean] => Self { mean: *mean, deviation: deviation(parts) },
            _ => Self { mean: mean(figures), deviation: deviation(figures) },
        }
    }

    /// The text of a table's cell.
    pub fn cell(&self) -> String {
        match self.deviation {
            _ if self.mean.is_nan() => "-".into(),
            Some(deviation) => format!("{:.3} ±{deviation:.3}", self.mean),
            None => format!("{:.3}", self.mean),
        }
    }

    /// Both numbers as cells of a CSV file.
    pub fn csv(&self) -> String {
        let number = |value: Option<f64>| {
            value.filter(|value| !value.is_nan()).map(|value| value.to_string()).unwrap_or_default()
        };
        format!("{},{}", number(Some(self.mean)), number(self.deviation))
    }
}

/// The name of the deviations of [`Statistic::over_seeds`]: over the seeds and models, or over the `parts` of a single seed,
/// such as `pairs`.
pub fn deviation_name(seeds: usize, models: usize, parts: &str) -> String {
    match (seeds, models) {
        (1, 1) => format!("standard deviation over {parts}"),
        (_, 1) => format!("standard deviation over {seeds} seeds"),
        (1, _) => format!("standard deviation over {models} models, without a model over {parts}"),
        _ => format!("standard deviation over {seeds} seeds and {models} models"),
    }
}

/// The arithmetic mean; NaN without values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_over_parts_or_seeds() {
        let one = Statistic::over_seeds(&[0.5], &[0.25, 0.75]);
        assert_eq!((one.cell().as_str(), one.csv().as_str()), ("0.500 ±0.354", "0.5,0.3535533905932738"));
        let three = Statistic::over_seeds(&[0.25, 0.5, 0.75], &[9.0, 9.0]);
        assert_eq!(three, Statistic { mean: 0.5, deviation: Some(0.25) });
        let alone = Statistic::over_seeds(&[0.5], &[0.5]);
        assert_eq!((alone.cell().as_str(), alone.csv().as_str()), ("0.500", "0.5,"));
        let none = Statistic::over_seeds(&[mean(&[])], &[]);
        assert_eq!((none.cell().as_str(), none.csv().as_str()), ("-", ","));
    }
}
