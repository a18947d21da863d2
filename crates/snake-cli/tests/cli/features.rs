//! A program without a feature says how to get it.
#![cfg(not(any(feature = "manual", feature = "parquet", feature = "rosbag2")))]

use super::{assert_refused, file, root, sample, snake};

#[test]
fn work_that_needs_a_feature_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let (parquet, pages) = (file(&folder, "keypoints.parquet"), file(&folder, "pages"));
    let bag = root().join("tests/data/io/drive.db3").display().to_string();
    let bag_folder = folder.path().join("drive");
    std::fs::create_dir(&bag_folder).unwrap();
    std::fs::copy(&bag, bag_folder.join("drive_0.db3")).unwrap();
    let bag_folder = bag_folder.display().to_string();
    for (arguments, feature) in [
        (&["detect", &sample(), "-o", &parquet][..], "parquet"),
        (&["detect", &sample(), "-o", "-", "--format", "parquet"], "parquet"),
        (&["detect", &bag], "rosbag2"),
        (&["detect", &bag_folder], "rosbag2"),
        (&["manual", &pages], "manual"),
    ] {
        let output = snake(arguments);
        assert_refused(&output, &format!("this build lacks the feature `{feature}`"));
        assert_refused(&output, &format!("cargo install --path crates/snake-cli --features {feature}"));
    }
}
