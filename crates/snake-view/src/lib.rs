//! A page that shows a cloud with its keypoints, surface and saliency in a browser; or two clouds with the keypoints
//! that repeat; or a registration with its matches ([`RegistrationPage`]). It is a single file and needs no server.
//!
//! ```
//! use snake_core::{Builtin, Chooser, Cloud, Control, Model, NamedModel};
//! use snake_view::{Page, ShownCloud, viridis};
//! # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
//! # let points = snake_io::read_points(path.as_ref())?[..1000].to_vec();
//! let model = NamedModel::new(Model::builtin(Builtin::Compact), "compact");
//! let chooser = Chooser::from(model);
//! let cloud = Cloud { points, origin: [0.0; 3] };
//! let chosen = chooser.for_cloud(&cloud)?;
//! let shown = ShownCloud::detect(&chosen, "plane".into(), &Control::default())?;
//! let (options, model_name) = (chosen.options, chosen.name.clone());
//! let page = Page { clouds: vec![shown], pair: None, options, model_name, colors: viridis() };
//! assert!(page.html()?.starts_with("<!doctype html>"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod page;
mod pair;
mod registration_page;
mod shown_cloud;
mod vertices;

pub use page::{Page, viridis};
pub use pair::ShownPair;
pub use registration_page::RegistrationPage;
pub use shown_cloud::ShownCloud;
