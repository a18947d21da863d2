//! Spans of the feature `tracing`.

use std::sync::{Arc, Mutex};

use snake_core::{Builtin, Model, Point};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

/// Keeps the names of all spans.
#[derive(Clone, Default)]
struct Names(Arc<Mutex<Vec<&'static str>>>);

impl Subscriber for Names {
    fn enabled(&self, metadata: &Metadata) -> bool {
        metadata.target().starts_with("snake_core")
    }

    fn new_span(&self, span: &Attributes) -> Id {
        let mut names = self.0.lock().unwrap();
        names.push(span.metadata().name());
        Id::from_u64(names.len() as u64)
    }

    fn record(&self, _: &Id, _: &Record) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn event(&self, _: &Event) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}

#[test]
fn every_step_of_a_detection_is_a_span() {
    let points: Vec<Point> = (0..500).map(|i| [(i % 20) as f32, (i / 20) as f32, ((i * i) % 17) as f32]).collect();
    let names = Names::default();
    let model = Model::builtin(Builtin::Compact);
    tracing::subscriber::with_default(names.clone(), || model.detect(&points, model.recommended()).unwrap());
    let entered = names.0.lock().unwrap().clone();
    assert_eq!(entered, ["encode", "pointnet", "unet", "occupancy", "refine", "suppress"]);
}
