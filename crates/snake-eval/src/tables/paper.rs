//! The figures of the SNAKE paper, shown beside our own.

/// A table of the paper.
pub struct PaperTable {
    /// The columns: epsilon, threshold, rate, σ or number of keypoints.
    pub(super) column_values: &'static [f64],
    pub(super) rows: &'static [(&'static str, &'static [f64])],
}

impl PaperTable {
    /// Each method with its figures for the given column values; `None` where it has none.
    pub fn at(&self, column_values: &[f64]) -> Vec<(&'static str, Vec<Option<f64>>)> {
        let column = |value: &f64| self.column_values.iter().position(|known| known == value);
        let columns: Vec<Option<usize>> = column_values.iter().map(column).collect();
        let row = |(method, figures): &(&'static str, &[f64])| {
            (*method, columns.iter().map(|column| column.map(|column| figures[column])).collect())
        };
        self.rows.iter().map(row).collect()
    }

    /// Rows of a table with these figures, marked as the paper's.
    pub fn rows(&self, column_values: &[f64]) -> Vec<Vec<String>> {
        let cell = |figure: Option<f64>| figure.map_or("-".into(), |figure| format!("{figure:.3}"));
        let row = |(method, figures): (&str, Vec<Option<f64>>)| {
            std::iter::once(format!("{method} (paper)")).chain(figures.into_iter().map(cell)).collect()
        };
        self.at(column_values).into_iter().map(row).collect()
    }
}

/// The three tables of a data set's repeatability.
pub struct PaperRepeatability {
    /// Over epsilon.
    pub epsilon: PaperTable,
    /// The epsilon of the other two tables.
    pub table_epsilon: f64,
    /// Over the down-sampling rate.
    pub downsample: PaperTable,
    /// Over the standard deviation of the noise.
    pub noise: PaperTable,
}

/// Repeatability on ModelNet40, in units of the objects' radius.
pub const MODELNET40: PaperRepeatability = PaperRepeatability {
    table_epsilon: 0.04,
    epsilon: PaperTable {
        column_values: &[0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1],
        rows: &[
            ("snake", &[0.763, 0.864, 0.897, 0.910, 0.917, 0.923, 0.927, 0.930]),
            ("iss", &[0.058, 0.096, 0.140, 0.192, 0.247, 0.306, 0.367, 0.427]),
            ("harris3d", &[0.056, 0.096, 0.147, 0.210, 0.277, 0.347, 0.415, 0.480]),
            ("sift3d", &[0.055, 0.092, 0.138, 0.191, 0.249, 0.308, 0.369, 0.429]),
            ("random", &[0.056, 0.094, 0.140, 0.191, 0.249, 0.308, 0.368, 0.429]),
            ("usip", &[0.771, 0.799, 0.815, 0.827, 0.836, 0.844, 0.851, 0.857]),
        ],
    },
    downsample: PaperTable {
        column_values: &[1.0, 2.0, 4.0, 8.0, 16.0],
        rows: &[
            ("snake", &[0.864, 0.851, 0.820, 0.730, 0.528]),
            ("iss", &[0.096, 0.088, 0.088, 0.083, 0.076]),
            ("harris3d", &[0.096, 0.093, 0.093, 0.093, 0.092]),
            ("sift3d", &[0.092, 0.089, 0.087, 0.082, 0.075]),
            ("random", &[0.094, 0.093, 0.093, 0.091, 0.092]),
            ("usip", &[0.799, 0.748, 0.685, 0.554, 0.321]),
        ],
    },
    noise: PaperTable {
        column_values: &[0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12],
        rows: &[
            ("snake", &[0.864, 0.869, 0.841, 0.766, 0.619, 0.464, 0.354]),
            ("iss", &[0.096, 0.061, 0.037, 0.025, 0.020, 0.016, 0.015]),
            ("harris3d", &[0.096, 0.063, 0.038, 0.029, 0.020, 0.015, 0.015]),
            ("sift3d", &[0.092, 0.060, 0.036, 0.025, 0.019, 0.016, 0.014]),
            ("random", &[0.094, 0.062, 0.038, 0.027, 0.021, 0.016, 0.014]),
            ("usip", &[0.799, 0.872, 0.844, 0.746, 0.558, 0.341, 0.192]),
        ],
    },
};

/// Repeatability on KeypointNet beside UKPGAN, in the units of its files.
pub const KEYPOINTNET_VIEWS: PaperRepeatability = PaperRepeatability {
    table_epsilon: 0.03,
    epsilon: PaperTable {
        column_values: &[0.03, 0.05, 0.07, 0.09, 0.1],
        rows: &[("snake", &[0.643, 0.806, 0.892, 0.936, 0.948]), ("ukpgan", &[0.199, 0.454, 0.661, 0.81, 0.864])],
    },
    downsample: PaperTable {
        column_values: &[1.0, 4.0, 8.0],
        rows: &[("snake", &[0.643, 0.594, 0.525]), ("ukpgan", &[0.199, 0.570, 0.427])],
    },
    noise: PaperTable {
        column_values: &[0.0, 0.02, 0.03],
        rows: &[("snake", &[0.643, 0.626, 0.536]), ("ukpgan", &[0.199, 0.608, 0.558])],
    },
};

/// Repeatability on Redwood, in metres.
#[allow(clippy::approx_constant)] // One figure happens to begin like 1 / π.
pub const REDWOOD: PaperRepeatability = PaperRepeatability {
    table_epsilon: 0.2,
    epsilon: PaperTable {
        column_values: &[0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.22, 0.24],
        rows: &[
            ("snake", &[0.205, 0.246, 0.286, 0.323, 0.359, 0.393, 0.425, 0.454]),
            ("iss", &[0.087, 0.119, 0.156, 0.191, 0.228, 0.264, 0.301, 0.336]),
            ("harris3d", &[0.079, 0.109, 0.140, 0.175, 0.209, 0.243, 0.278, 0.310]),
            ("sift3d", &[0.088, 0.123, 0.168, 0.210, 0.254, 0.297, 0.330, 0.367]),
            ("random", &[0.090, 0.126, 0.163, 0.204, 0.246, 0.287, 0.326, 0.362]),
            ("usip", &[0.255, 0.285, 0.314, 0.342, 0.368, 0.392, 0.417, 0.439]),
        ],
    },
    downsample: PaperTable {
        column_values: &[1.0, 2.0, 4.0, 8.0, 16.0],
        rows: &[
            ("snake", &[0.393, 0.394, 0.391, 0.381, 0.362]),
            ("iss", &[0.264, 0.277, 0.158, 0.067, 0.021]),
            ("harris3d", &[0.243, 0.288, 0.285, 0.292, 0.286]),
            ("sift3d", &[0.297, 0.286, 0.280, 0.271, 0.220]),
            ("random", &[0.287, 0.289, 0.291, 0.292, 0.287]),
            ("usip", &[0.392, 0.388, 0.377, 0.351, 0.313]),
        ],
    },
    noise: PaperTable {
        column_values: &[0.0, 0.02, 0.04, 0.06, 0.08, 0.1],
        rows: &[
            ("snake", &[0.393, 0.392, 0.381, 0.359, 0.318, 0.256]),
            ("iss", &[0.264, 0.260, 0.268, 0.259, 0.250, 0.214]),
            ("harris3d", &[0.243, 0.239, 0.225, 0.206, 0.193, 0.178]),
            ("sift3d", &[0.297, 0.289, 0.270, 0.261, 0.241, 0.217]),
            ("random", &[0.287, 0.289, 0.275, 0.252, 0.230, 0.210]),
            ("usip", &[0.392, 0.386, 0.375, 0.341, 0.317, 0.295]),
        ],
    },
};

/// Thresholds of the tables of semantic consistency.
const THRESHOLDS: &[f64] = &[0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1];

/// mIoU on KeypointNet: airplanes, chairs and tables.
pub const KEYPOINTNET: PaperTable = PaperTable {
    column_values: THRESHOLDS,
    rows: &[
        ("snake", &[0.006, 0.012, 0.025, 0.039, 0.058, 0.091, 0.144, 0.214, 0.291, 0.361, 0.412]),
        ("iss", &[0.008, 0.012, 0.024, 0.040, 0.060, 0.088, 0.121, 0.160, 0.198, 0.242, 0.286]),
        ("harris3d", &[0.005, 0.010, 0.014, 0.023, 0.040, 0.060, 0.084, 0.110, 0.150, 0.180, 0.216]),
        ("sift3d", &[0.005, 0.010, 0.015, 0.022, 0.043, 0.065, 0.089, 0.120, 0.160, 0.189, 0.221]),
        ("random", &[0.005, 0.010, 0.017, 0.020, 0.023, 0.026, 0.028, 0.032, 0.036, 0.042, 0.049]),
        ("usip", &[0.003, 0.006, 0.013, 0.024, 0.045, 0.078, 0.116, 0.160, 0.212, 0.264, 0.314]),
        ("ukpgan", &[0.005, 0.009, 0.021, 0.036, 0.059, 0.084, 0.114, 0.147, 0.179, 0.207, 0.238]),
    ],
};

/// mIoU on pairs of SMPL bodies.
pub const SMPL: PaperTable = PaperTable {
    column_values: THRESHOLDS,
    rows: &[
        ("snake", &[0.063, 0.079, 0.094, 0.128, 0.182, 0.255, 0.355, 0.457, 0.557, 0.639, 0.704]),
        ("iss", &[0.078, 0.095, 0.101, 0.113, 0.129, 0.148, 0.174, 0.206, 0.231, 0.258, 0.293]),
        ("harris3d", &[0.012, 0.013, 0.016, 0.021, 0.032, 0.047, 0.065, 0.097, 0.129, 0.159, 0.187]),
        ("sift3d", &[0.009, 0.011, 0.016, 0.026, 0.043, 0.064, 0.084, 0.108, 0.146, 0.183, 0.213]),
        ("random", &[0.008, 0.011, 0.015, 0.021, 0.038, 0.056, 0.075, 0.103, 0.136, 0.161, 0.195]),
        ("usip", &[0.037, 0.043, 0.051, 0.081, 0.129, 0.198, 0.278, 0.338, 0.390, 0.440, 0.492]),
        ("ukpgan", &[0.036, 0.041, 0.059, 0.085, 0.126, 0.171, 0.235, 0.302, 0.369, 0.424, 0.476]),
    ],
};

/// Numbers of keypoints of the registration table.
const KEYPOINTS: &[f64] = &[2500.0, 1000.0, 500.0, 250.0, 100.0];

/// Registration on the eight scenes of 3DMatch, with the descriptor D3Feat.
pub struct PaperRegistration {
    /// Feature matching recall.
    pub feature_matching_recall: PaperTable,
    /// Inlier ratio.
    pub inlier_ratio: PaperTable,
    /// Registration recall.
    pub registration_recall: PaperTable,
}

/// Registration on 3DMatch, over the number of keypoints.
pub const THREE_D_MATCH: PaperRegistration = PaperRegistration {
    feature_matching_recall: PaperTable {
        column_values: KEYPOINTS,
        rows: &[
            ("snake d3feat", &[0.955, 0.950, 0.947, 0.929, 0.895]),
            ("iss d3feat", &[0.952, 0.944, 0.934, 0.901, 0.810]),
            ("sift3d d3feat", &[0.949, 0.940, 0.930, 0.912, 0.813]),
            ("random d3feat", &[0.951, 0.945, 0.928, 0.900, 0.812]),
            ("ukpgan d3feat", &[0.947, 0.942, 0.935, 0.926, 0.859]),
            ("d3feat d3feat", &[0.956, 0.945, 0.943, 0.933, 0.906]),
        ],
    },
    inlier_ratio: PaperTable {
        column_values: KEYPOINTS,
        rows: &[
            ("snake d3feat", &[0.413, 0.390, 0.370, 0.335, 0.300]),
            ("iss d3feat", &[0.382, 0.335, 0.288, 0.239, 0.174]),
            ("sift3d d3feat", &[0.384, 0.336, 0.288, 0.233, 0.174]),
            ("random d3feat", &[0.386, 0.336, 0.289, 0.236, 0.173]),
            ("ukpgan d3feat", &[0.388, 0.355, 0.340, 0.331, 0.277]),
            ("d3feat d3feat", &[0.406, 0.427, 0.441, 0.450, 0.456]),
        ],
    },
    registration_recall: PaperTable {
        column_values: KEYPOINTS,
        rows: &[
            ("snake d3feat", &[0.851, 0.837, 0.812, 0.746, 0.509]),
            ("iss d3feat", &[0.835, 0.792, 0.760, 0.643, 0.372]),
            ("sift3d d3feat", &[0.840, 0.799, 0.761, 0.609, 0.386]),
            ("random d3feat", &[0.830, 0.800, 0.770, 0.655, 0.388]),
            ("ukpgan d3feat", &[0.828, 0.814, 0.771, 0.697, 0.474]),
            ("d3feat d3feat", &[0.844, 0.849, 0.825, 0.793, 0.672]),
        ],
    },
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_a_figure_for_every_column() {
        let repeatability_tables =
            [&MODELNET40, &KEYPOINTNET_VIEWS, &REDWOOD].map(|set| [&set.epsilon, &set.downsample, &set.noise]);
        let registration =
            [&THREE_D_MATCH.feature_matching_recall, &THREE_D_MATCH.inlier_ratio, &THREE_D_MATCH.registration_recall];
        let tables = repeatability_tables.into_iter().chain([[&KEYPOINTNET, &SMPL, &SMPL], registration]).flatten();
        for PaperTable { column_values, rows } in tables {
            assert!(rows.iter().all(|(_, figures)| figures.len() == column_values.len()));
            assert!(rows.iter().all(|(_, figures)| figures.iter().all(|figure| (0.0..1.0).contains(figure))));
        }
    }

    #[test]
    fn columns_that_the_paper_has_not_stay_empty() {
        let rows = KEYPOINTNET.rows(&[0.1, 0.3]);
        assert_eq!(rows[0], ["snake (paper)", "0.412", "-"]);
        assert_eq!(KEYPOINTNET.at(&[0.3, 0.05])[1], ("iss", vec![None, Some(0.088)]));
    }
}
