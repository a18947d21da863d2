//! Reads the poses of many clouds: the output of `align`, and TUM and KITTI trajectories.

use std::path::Path;

use serde::Deserialize;

use crate::formats::quaternion::rotation;
use crate::formats::{extension, unknown_extension};
use crate::text::header::is_comment;
use crate::text::lines::{Lines, text};
use crate::text::number::number;
use crate::{Error, Result};
use snake_geometry::{RigidTransform, excerpt};

/// The extensions that [`read_poses`] accepts.
pub const POSE_EXTENSIONS: &[&str] = &["json", "txt", "tum"];

/// Poses of clouds in one frame, `p_frame = R p_cloud + t`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Poses {
    /// Each pose with the path of its cloud.
    Named(Vec<(String, RigidTransform)>),
    /// Each pose with its time, which is the name of its cloud.
    Timed(Vec<(f64, RigidTransform)>),
    /// In the order of the clouds.
    Ordered(Vec<RigidTransform>),
}

#[derive(Deserialize)]
struct Written {
    clouds: Vec<String>,
    poses: Vec<WrittenPose>,
}

#[derive(Deserialize)]
struct WrittenPose {
    part: usize,
    t_part_cloud: [[f64; 4]; 4],
}

/// Reads the poses of clouds.
///
/// A `json` file holds the output of `snake-cli align`; only the poses of its largest part count. A `txt` or `tum`
/// file holds one pose per line: `time x y z qx qy qz qw` (TUM), or the three rows of `[R t]` (KITTI).
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among [`POSE_EXTENSIONS`] or
/// the content is not of these forms.
pub fn read_poses(path: &Path) -> Result<Poses> {
    let read = match extension(path).as_str() {
        "json" => read_json,
        "txt" | "tum" => read_text,
        _ => return Err(unknown_extension(path, "read", POSE_EXTENSIONS)),
    };
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    read(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

impl Poses {
    /// The pose of each cloud for which the file has one. A pose belongs to the cloud with its path. If no path is equal, it
    /// belongs to the only cloud with its file name.
    ///
    /// # Errors
    /// [`Error::Format`] for the file of poses when no pose belongs to these clouds, or when the number of poses without
    /// names is not the number of clouds.
    pub fn for_clouds(&self, file: &Path, clouds: &[impl AsRef<Path>]) -> Result<Vec<Option<RigidTransform>>> {
        let refused = |reason| Err(Error::Format { path: file.into(), reason });
        let clouds = clouds.iter().map(AsRef::as_ref);
        let all: Vec<Option<RigidTransform>> = match self {
            Self::Named(poses) => clouds.map(|cloud| named(poses, cloud)).collect(),
            Self::Timed(poses) => {
                let times = clouds.clone().map(|cloud| number(&cloud.file_stem()?.to_string_lossy()));
                let at =
                    |time: Option<f64>| poses.iter().find(|(other, _)| Some(*other) == time).map(|(_, pose)| *pose);
                let by_time: Vec<_> = times.map(at).collect();
                let is_ordered = by_time.iter().all(Option::is_none) && poses.len() == by_time.len();
                if is_ordered { poses.iter().map(|(_, pose)| Some(*pose)).collect() } else { by_time }
            }
            Self::Ordered(poses) if poses.len() != clouds.len() => {
                return refused(format!("{} poses without names, of {} clouds", poses.len(), clouds.len()));
            }
            Self::Ordered(poses) => poses.iter().copied().map(Some).collect(),
        };
        if all.iter().all(Option::is_none) {
            return refused("no pose is of one of the clouds, by its path, file name or time".into());
        }
        Ok(all)
    }
}

/// The pose of a cloud by its path, or by its file name if only one pose has it.
fn named(poses: &[(String, RigidTransform)], cloud: &Path) -> Option<RigidTransform> {
    if let Some((_, pose)) = poses.iter().find(|(name, _)| Path::new(name) == cloud) {
        return Some(*pose);
    }
    let mut same = poses.iter().filter(|(name, _)| Path::new(name).file_name() == cloud.file_name());
    let (_, pose) = same.next()?;
    same.next().is_none().then_some(*pose)
}

fn read_json(bytes: &[u8]) -> std::result::Result<Poses, String> {
    let expected = || "expected {\"clouds\": [..], \"poses\": [{\"part\": .., \"t_part_cloud\": [[..4], ..4]}, ..]}";
    let Written { clouds, poses } = serde_json::from_slice(bytes).map_err(|_| expected())?;
    if clouds.len() != poses.len() {
        return Err(format!("{} poses of {} clouds", poses.len(), clouds.len()));
    }
    let largest = clouds.into_iter().zip(poses).filter(|(_, pose)| pose.part == 0);
    let checked = |(name, pose): (String, WrittenPose)| {
        let pose = RigidTransform::from_matrix(pose.t_part_cloud)
            .map_err(|error| format!("{}: {error}", excerpt(&name, 60)))?;
        Ok((name, pose))
    };
    Ok(Poses::Named(largest.map(checked).collect::<std::result::Result<_, String>>()?))
}

fn read_text(bytes: &[u8]) -> std::result::Result<Poses, String> {
    let (mut timed, mut ordered) = (Vec::new(), Vec::new());
    for (line_number, line) in Lines::from_text(bytes)? {
        if is_comment(line) {
            continue;
        }
        let line = text(line);
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(number).collect();
        let pose = match numbers.as_deref() {
            Some(&[time, x, y, z, qx, qy, qz, qw]) => {
                rotation([qw, qx, qy, qz]).map(|rows| (Some(time), rows, [x, y, z]))
            }
            Some(&[a, b, c, x, d, e, f, y, g, h, i, z]) => Ok((None, [[a, b, c], [d, e, f], [g, h, i]], [x, y, z])),
            _ => Err(format!(
                "expected `time x y z qx qy qz qw` or the twelve numbers of three rows, and there is {}",
                excerpt(&line, 60)
            )),
        };
        let on_line = |error: String| format!("line {line_number}: {error}");
        let (time, [a, b, c], [x, y, z]) = pose.map_err(on_line)?;
        let row = |[u, v, w]: [f64; 3], t| [u, v, w, t];
        let rows = [row(a, x), row(b, y), row(c, z), [0.0, 0.0, 0.0, 1.0]];
        let pose = RigidTransform::from_matrix(rows).map_err(|error| on_line(error.to_string()))?;
        match time {
            Some(time) => timed.push((time, pose)),
            None => ordered.push(pose),
        }
    }
    match (timed.is_empty(), ordered.is_empty()) {
        (false, true) => Ok(Poses::Timed(timed)),
        (true, false) => Ok(Poses::Ordered(ordered)),
        (true, true) => Err("no poses".into()),
        (false, false) => Err("lines of 8 and of 12 numbers".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUARTER: [[f64; 4]; 4] =
        [[0.0, -1.0, 0.0, 1.5], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];

    fn matrices(poses: Vec<Option<RigidTransform>>) -> Vec<Option<[[f64; 4]; 4]>> {
        let rounded = |pose: RigidTransform| pose.to_matrix().map(|row| row.map(|v| (v * 1e9).round() / 1e9 + 0.0));
        poses.into_iter().map(|pose| pose.map(rounded)).collect()
    }

    #[test]
    fn all_forms_hold_the_same_poses() {
        let file = Path::new("poses");
        let identity = RigidTransform::identity().to_matrix();
        let json = serde_json::json!({
            "clouds": ["a/0.ply", "a/1.ply", "a/2.ply"],
            "poses": [{"part": 0, "t_part_cloud": QUARTER}, {"part": 1, "t_part_cloud": QUARTER}, {"part": 0, "t_part_cloud": identity}],
        });
        let named = read_json(json.to_string().as_bytes()).unwrap();
        // A cloud of another part has no pose here. The folder may have moved.
        let poses = named.for_clouds(file, &["b/2.ply", "a/0.ply", "a/1.ply", "new.ply"]).unwrap();
        assert_eq!(matrices(poses), [Some(identity), Some(QUARTER), None, None]);
        let tum =
            read_text(b"# time x y z qx qy qz qw\n7.5 1.5 -2 3 0 0 0.70710678118 0.70710678118\n8 0 0 0 0 0 0 1\n")
                .unwrap();
        assert_eq!(
            matrices(tum.for_clouds(file, &["8.pcd", "9.pcd", "7.50.pcd"]).unwrap()),
            [Some(identity), None, Some(QUARTER)]
        );
        assert_eq!(matrices(tum.for_clouds(file, &["a.pcd", "b.pcd"]).unwrap()), [Some(QUARTER), Some(identity)]);
        let kitti = read_text(b"0 -1 0 1.5 1 0 0 -2 0 0 1 3\n1 0 0 0 0 1 0 0 0 0 1 0\n").unwrap();
        assert_eq!(matrices(kitti.for_clouds(file, &["a.bin", "b.bin"]).unwrap()), [Some(QUARTER), Some(identity)]);
        for (poses, clouds) in [(&named, ["x.ply"]), (&tum, ["x.ply"]), (&kitti, ["x.ply"])] {
            let error = poses.for_clouds(file, &clouds).unwrap_err().to_string();
            assert!(error.starts_with("poses: ") && error.contains("clouds"), "{error}");
        }
    }

    #[test]
    fn anything_else_is_refused_with_its_line() {
        for (bytes, reason) in [
            ("", "no poses"),
            ("1 2 3\n", "line 1: expected `time x y z qx qy qz qw`"),
            ("1 0 0 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n", "lines of 8 and of 12"),
            ("# a\n2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: "),
            ("0 nan 0 0 0 0 0 1\n", "line 1: "),
        ] {
            let error = read_text(bytes.as_bytes()).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
        assert!(read_json(b"[[1]]").unwrap_err().contains("t_part_cloud"));
        assert!(read_json(br#"{"clouds": ["a"], "poses": []}"#).unwrap_err().contains("0 poses of 1 clouds"));
        assert!(read_poses(Path::new("poses.csv")).unwrap_err().to_string().contains(".json, .txt, .tum"));
    }
}
