//! The implicit decoder: a residual MLP on the query, which adds the interpolated feature to the input of every block.

use crate::lattice::VolumeShape;
use crate::network::layers::{Linear, ResnetBlockFc};
use crate::network::weights::Scope;
use crate::{ModelConfig, Result};
use snake_geometry::Point;
use snake_kernels::Epilogue;

/// The function that maps a decoder's logit to a probability.
#[derive(Debug, Clone, Copy)]
enum Head {
    /// Sigmoid.
    Occupancy,
    /// softplus / (1 + softplus).
    Saliency,
}

impl Head {
    /// The probability and its derivative with respect to the logit.
    fn apply(self, logit: f32) -> (f32, f32) {
        let sigmoid = 1.0 / (1.0 + (-logit).exp());
        match self {
            Self::Occupancy => (sigmoid, sigmoid * (1.0 - sigmoid)),
            Self::Saliency => {
                let softplus = if logit > 20.0 { logit } else { logit.exp().ln_1p() };
                (softplus / (1.0 + softplus), sigmoid / (1.0 + softplus).powi(2))
            }
        }
    }
}

/// One of a model's two decoders.
#[derive(Debug)]
pub(crate) struct Decoder {
    head: Head,
    fc_p: Linear,
    stages: Vec<Stage>,
    fc_out: Linear,
}

#[derive(Debug)]
struct Stage {
    fc_c: Linear,
    block: ResnetBlockFc,
}

/// The activations that the backward pass needs: outputs of ReLUs, whose zeros stop the gradient.
struct Trace {
    /// ReLU of each block's input and of its first layer's output, `(2 stages, queries, width)`; without a backward
    /// pass, only those of the last block.
    relus: Vec<f32>,
    /// ReLU of the last block's output.
    last: Vec<f32>,
}

/// Values of a field at queries, with their derivatives with respect to the query's coordinates (at a constant feature)
/// and with respect to the feature.
pub(crate) struct ValuesAndGradients {
    pub(crate) values: Vec<f32>,
    /// `(queries, 3)`.
    pub(crate) in_query: Vec<f32>,
    /// `(queries, c_dim)`.
    pub(crate) in_feature: Vec<f32>,
}

impl Decoder {
    pub(crate) fn occupancy(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        Self::load(scope, config, Head::Occupancy)
    }

    pub(crate) fn saliency(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        Self::load(scope, config, Head::Saliency)
    }

    fn load(scope: &Scope, config: &ModelConfig, head: Head) -> Result<Self> {
        let width = config.decoder_hidden_dim;
        let stage = |i| {
            Ok(Stage {
                fc_c: Linear::load(&scope.at(&format!("fc_c.{i}")), config.c_dim, width)?,
                block: ResnetBlockFc::load(&scope.at(&format!("blocks.{i}")), width)?,
            })
        };
        Ok(Self {
            head,
            fc_p: match config.volume {
                VolumeShape::Cube(_) => Linear::load(&scope.at("fc_p"), 3, width)?,
                // A scene's decoders do not receive the query's position, so their values do not depend on the origin.
                VolumeShape::Scene { .. } => {
                    Linear::new(3, width, &vec![0.0; 3 * width], &scope.at("fc_p").tensor("bias", &[width])?)
                }
            },
            stages: (0..config.resnet_blocks).map(stage).collect::<Result<_>>()?,
            fc_out: Linear::load(&scope.at("fc_out"), width, 1)?,
        })
    }

    /// Probabilities at queries `(queries, 3)` in the network's frame with their features `(queries, c_dim)`.
    pub(crate) fn values(&self, queries: &[Point], features: &[f32]) -> Vec<f32> {
        let (logits, _) = self.logits(queries, features, false);
        logits.into_iter().map(|logit| self.head.apply(logit).0).collect()
    }

    /// Probabilities and gradients; the backward pass is hand-written.
    pub(crate) fn values_and_gradients(&self, queries: &[Point], features: &[f32]) -> ValuesAndGradients {
        let (logits, trace) = self.logits(queries, features, true);
        let (values, slopes): (Vec<f32>, Vec<f32>) = logits.into_iter().map(|logit| self.head.apply(logit)).unzip();

        let size = trace.last.len();
        let (mut gradient, mut in_hidden) = (vec![0.0; size], vec![0.0; size]);
        let mut in_feature = vec![0.0; features.len()];
        self.fc_out.backward(&slopes, &mut gradient, Epilogue::Mask(&trace.last));
        for (stage, relus) in self.stages.iter().zip(trace.relus.chunks_exact(2 * size)).rev() {
            let (input, hidden) = relus.split_at(size);
            stage.block.fc_1.backward(&gradient, &mut in_hidden, Epilogue::Mask(hidden));
            stage.block.fc_0.backward(&in_hidden, &mut gradient, Epilogue::AddMasked(input));
            stage.fc_c.backward(&gradient, &mut in_feature, Epilogue::Add);
        }
        let mut in_query = vec![0.0; queries.len() * 3];
        self.fc_p.backward(&gradient, &mut in_query, Epilogue::Store);
        ValuesAndGradients { values, in_query, in_feature }
    }

    fn logits(&self, queries: &[Point], features: &[f32], traced: bool) -> (Vec<f32>, Trace) {
        let size = queries.len() * self.fc_p.outputs();
        let mut state = vec![0.0; size];
        let mut relus = vec![0.0; 2 * size * if traced { self.stages.len() } else { 1 }];
        self.fc_p.forward(queries.as_flattened(), &mut state, Epilogue::Store);
        for (number, stage) in self.stages.iter().enumerate() {
            let relus = &mut relus[if traced { 2 * size * number } else { 0 }..][..2 * size];
            let (input, hidden) = relus.split_at_mut(size);
            stage.fc_c.forward(features, &mut state, Epilogue::AddAndRelu(input));
            stage.block.fc_0.forward(input, hidden, Epilogue::Relu);
            stage.block.fc_1.forward(hidden, &mut state, Epilogue::Add);
        }
        state.iter_mut().for_each(|v| *v = v.max(0.0));
        let mut logits = vec![0.0; queries.len()];
        self.fc_out.forward(&state, &mut logits, Epilogue::Store);
        (logits, Trace { relus, last: state })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_finite_and_their_slopes_match_differences() {
        for head in [Head::Occupancy, Head::Saliency] {
            for logit in [-200.0, -20.0, -1.5, 0.0, 0.7, 19.9, 20.1, 200.0] {
                let (value, slope) = head.apply(logit);
                assert!((0.0..=1.0).contains(&value) && slope.is_finite(), "{head:?} {logit}");
                let difference = (head.apply(logit + 0.01).0 - head.apply(logit - 0.01).0) / 0.02;
                assert!((slope - difference).abs() < 1e-4, "{head:?} {logit}: {slope} {difference}");
            }
        }
    }
}
