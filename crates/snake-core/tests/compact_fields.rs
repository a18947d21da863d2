//! The fields of the built-in weights, which scatter softly, against those of the PyTorch network
//! (tests/data/compact_fields.py).

use serde::Deserialize;
use snake_core::{Builtin, EncodeOptions, Model, NormalizationMethod, Point};

#[derive(Deserialize)]
struct Fields {
    points: Vec<Point>,
    queries: Vec<Point>,
    occupancy: Vec<f32>,
    saliency: Vec<f32>,
}

#[test]
fn the_fields_of_compact_are_those_of_pytorch() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/compact_fields.json");
    let expected: Fields = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let options = EncodeOptions::default().with_normalization(NormalizationMethod::None);
    let field = Model::builtin(Builtin::Compact).encode(&expected.points, &options).unwrap();
    // Both add the same products in other orders, and the stored values have six digits.
    let compare = |name: &str, found: Vec<f32>, expected: &[f32]| {
        assert_eq!(found.len(), expected.len());
        for (query, (found, expected)) in found.iter().zip(expected).enumerate() {
            assert!((found - expected).abs() < 1e-4, "{name} of query {query}: {found}, expected {expected}");
        }
    };
    compare("occupancy", field.occupancy(&expected.queries).unwrap(), &expected.occupancy);
    compare("saliency", field.saliency(&expected.queries).unwrap(), &expected.saliency);
    // The network is not constant there.
    let (low, high) = expected.saliency.iter().fold((1.0_f32, 0.0_f32), |(l, h), &v| (l.min(v), h.max(v)));
    assert!(high - low > 0.2);
}
