//! The paper's own figures, to stand beside ours.

/// A row of the paper's tables.
pub struct PaperRow {
    pub method: &'static str,
    /// By epsilon or threshold in hundredths.
    figures: &'static [(u32, f64)],
}

impl PaperRow {
    /// The figures at the given places, where it has them.
    pub fn at(&self, places: &[f64]) -> Vec<Option<f64>> {
        let at = |place: &f64| self.figures.iter().find(|(hundredths, _)| f64::from(*hundredths) / 100.0 == *place);
        places.iter().map(|place| at(place).map(|(_, figure)| *figure)).collect()
    }

    /// The same as cells of a table.
    pub fn cells(&self, places: &[f64]) -> Vec<String> {
        self.at(places).into_iter().map(|figure| figure.map_or("-".into(), |figure| format!("{figure:.3}"))).collect()
    }
}

/// Repeatability on ModelNet40, in units of the objects' radius.
pub const MODELNET40: [PaperRow; 2] = [
    PaperRow {
        method: "SNAKE (paper)",
        figures: &[(3, 0.763), (4, 0.864), (5, 0.897), (6, 0.910), (7, 0.917), (8, 0.923), (9, 0.927), (10, 0.930)],
    },
    PaperRow {
        method: "random (paper)",
        figures: &[(3, 0.056), (4, 0.094), (5, 0.140), (6, 0.191), (7, 0.249), (8, 0.308), (9, 0.368), (10, 0.429)],
    },
];

/// Repeatability on Redwood, in metres.
pub const REDWOOD: [PaperRow; 2] = [
    PaperRow {
        method: "SNAKE (paper)",
        figures: &[
            (10, 0.205),
            (12, 0.246),
            (14, 0.286),
            (16, 0.323),
            (18, 0.359),
            (20, 0.393),
            (22, 0.425),
            (24, 0.454),
        ],
    },
    PaperRow {
        method: "random (paper)",
        figures: &[
            (10, 0.090),
            (12, 0.126),
            (14, 0.163),
            (16, 0.204),
            (18, 0.246),
            (20, 0.287),
            (22, 0.326),
            (24, 0.362),
        ],
    },
];

/// mIoU on KeypointNet: airplanes, chairs and tables.
pub const KEYPOINTNET: [PaperRow; 1] = [PaperRow {
    method: "SNAKE (paper)",
    figures: &[
        (0, 0.006),
        (1, 0.012),
        (2, 0.025),
        (3, 0.039),
        (4, 0.058),
        (5, 0.091),
        (6, 0.144),
        (7, 0.214),
        (8, 0.291),
        (9, 0.361),
        (10, 0.412),
    ],
}];
