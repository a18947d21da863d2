//! `snake_rs.tiles`: clouds that do not fit into memory.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyTuple};
use snake_core::{Detection, Length, TileDetector, add_origin};
use snake_io::ReadOptions;
use snake_tiles::{Detected, Tile, TiledKeypoint, TiledRun};

use crate::arrays::{self, Precision};
use crate::error::tiles_error;
use crate::keypoints::{Keypoints, counts_dict};
use crate::model::{self, Model};
use crate::{options, remote, threads};

/// Splits a cloud that does not fit into memory into tiles of about `tile` cloud units along x and y. `paths` is the path of a
/// file or of a folder of clouds, or a list of paths, that make up one cloud. Its points are written to `folder`, 20 bytes
/// each; the folder then gets the results of the tiles. The same call continues the run there, also in several processes at a
/// time. The folder must be new, empty or of the same inputs, model and options.
///
/// COPC files are not copied: each tile reads its part of them. A path may be a URL that fsspec opens, such as
/// `s3://bucket/city.copc.laz` or `https://..`, and `s3://bucket/city/` for a folder; `storage_options` are those of its file system. Of COPC files ranges of bytes
/// are read; files of other formats are copied to the folder once.
///
/// `model` and `options` are those of `detect`; the model is one of scenes, by default "scenes". Give `voxel_size` in cloud units:
/// it is chosen only for clouds of at most 2 million points. Lengths in resolutions, such as the `mode_radius` of "scenes", need all
/// points once: give cloud units if a COPC file is far away. All keypoints are kept unless `max_keypoints` is given. Files that cannot be read are left out and stand in
/// `Tiles.failures`.
///
/// Raises ValueError for an invalid value, an option that needs the whole cloud, coordinates in degrees, or files of different
/// coordinate reference systems, or a folder with another run or with files that no run wrote; OSError for a file or a folder that
/// cannot be read or written.
#[pyfunction]
#[pyo3(signature = (paths, tile, folder, model=None, storage_options=None, **options))]
pub fn tiles(
    py: Python<'_>,
    paths: Paths,
    tile: f64,
    folder: PathBuf,
    model: Option<&Bound<'_, PyAny>>,
    storage_options: Option<&Bound<'_, PyDict>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Tiles> {
    let model = match model {
        Some(model) => model::given(py, model)?,
        None => Bound::new(py, Model::py_builtin(py, "scenes")?)?,
    };
    let mut resolved = options::resolve("tiles", &options::ALL, model.get().core().recommended(), options)?;
    if !options.is_some_and(|options| options.contains("max_keypoints").unwrap_or(false)) {
        resolved.detect.max_keypoints = usize::MAX;
    }
    let paths = match paths {
        Paths::One(path) => vec![path],
        Paths::Several(paths) => paths,
    };
    let read = ReadOptions::default().with_seed(resolved.encode.seed);
    let inputs = remote::Inputs::new(py, paths, &folder, storage_options)?;
    let remote = inputs.remote(py);
    Tiles::new(py, model, &resolved, remote, move |detector| match inputs {
        remote::Inputs::Copc(files, _) => TiledRun::prepare_copc(detector, files, tile, &folder),
        remote::Inputs::Local(paths) => TiledRun::prepare(detector, &paths, &read, tile, &folder),
    })
}

/// One path or several.
#[derive(FromPyObject)]
pub enum Paths {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

/// The tiles of a cloud, made by `tiles`. They are numbered from 0 to `len(tiles) - 1`.
///
/// It can be pickled, also for other machines that see its folder under the same path. They read COPC files themselves, other
/// files of the cloud are not needed there.
#[pyclass(frozen, module = "snake_rs")]
pub struct Tiles {
    run: Arc<TiledRun>,
    model: Py<Model>,
    /// The files that are read by byte ranges, which the pickle needs.
    remote: Vec<Py<PyAny>>,
}

impl Tiles {
    fn new(
        py: Python<'_>,
        model: Bound<'_, Model>,
        options: &snake_core::Options,
        remote: Vec<Py<PyAny>>,
        make: impl FnOnce(TileDetector) -> snake_tiles::Result<TiledRun> + Send,
    ) -> PyResult<Self> {
        let core = model.get().core();
        let run = threads::run_with_signals(py, |_| {
            let detector = TileDetector::new(core, options)?;
            Ok(make(detector))
        })?;
        Ok(Self { run: Arc::new(run.map_err(tiles_error)?), model: model.unbind(), remote })
    }

    fn tile(&self, tile: usize) -> PyResult<&Tile> {
        nth(&self.run, tile)
    }
}

fn nth(run: &TiledRun, tile: usize) -> PyResult<&Tile> {
    let number = run.tiles().len();
    run.tiles().get(tile).ok_or_else(|| PyIndexError::new_err(format!("tile {tile} of {number}, which count from 0")))
}

#[pymethods]
impl Tiles {
    /// One dict a tile, in their order: `tile` (its number), `folder`, its bounds `west`, `south`, `east` and `north` in the
    /// units of the files, and `num_points`, which says how long it takes.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let row = |(number, tile): (usize, &Tile)| {
            let [[west, south], [east, north]] = self.run.bounds(tile);
            let row = [("west", west), ("south", south), ("east", east), ("north", north)].into_py_dict(py)?;
            row.set_item("tile", number)?;
            row.set_item("folder", self.folder().to_string_lossy())?;
            row.set_item("num_points", tile.num_points)?;
            Ok(row)
        };
        self.run.tiles().iter().enumerate().map(row).collect()
    }

    /// The folder with the points and the results of the tiles.
    #[getter]
    fn folder(&self) -> PathBuf {
        self.run.folder().to_owned()
    }

    /// The input files that were left out because they could not be read: a dict from path to reason.
    #[getter]
    fn failures<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.run.failures().iter().map(|failure| (&failure.path, &failure.reason)).into_py_dict(py)
    }

    /// The limit of the number of keypoints, or None.
    #[getter]
    fn max_keypoints(&self) -> Option<usize> {
        Some(self.run.options().detect.max_keypoints).filter(|number| *number < usize::MAX)
    }

    /// Detects one tile and writes the result to the folder, unless it is there. Raises ValueError for damaged points in the
    /// folder, OSError for files that cannot be read or written, IndexError for another number than those of the tiles.
    fn detect(&self, py: Python<'_>, tile: usize) -> PyResult<()> {
        let tile = self.tile(tile)?;
        threads::run_with_signals(py, |control| Ok(self.run.detect(tile, control)))?.map_err(tiles_error)
    }

    /// Whether a tile is detected.
    fn is_detected(&self, py: Python<'_>, tile: usize) -> PyResult<bool> {
        let tile = self.tile(tile)?;
        Ok(py.detach(|| self.run.is_detected(tile)))
    }

    /// Looks at the results in the folder, once all tiles are detected. Raises as `Tiles.detect`.
    fn detected(&self, py: Python<'_>) -> PyResult<DetectedTiles> {
        let detected = py.detach(|| self.run.detected()).map_err(tiles_error)?;
        Ok(DetectedTiles { run: self.run.clone(), detected })
    }

    /// The keypoints of the whole cloud, with the bits of `detect`. `timing_seconds` are 0. Raises ValueError when tiles are
    /// missing, and as `detect`.
    fn finish(&self, py: Python<'_>) -> PyResult<Keypoints> {
        let finished = threads::run_with_signals(py, |control| Ok(self.run.finish(control)))?.map_err(tiles_error)?;
        let mut detection = Detection::default();
        detection.keypoints = finished.keypoints.iter().map(|keypoint| keypoint.keypoint).collect();
        detection.counts = finished.counts;
        detection.num_skipped = self.run.num_points().1 as usize;
        if let Some(Length::Units(size)) = self.run.options().encode.voxel_size {
            detection.voxel_size = Some(size as f32);
        }
        let named = self.model.get().named();
        let source = (named.name, named.model.digest(), Vec::new());
        Keypoints::from_detection(py, detection, self.run.origin(), Precision::Double, None, source)
    }

    /// Opens the tiles of a folder, for `pickle`.
    #[staticmethod]
    fn _open(
        py: Python<'_>,
        folder: PathBuf,
        model: &Bound<'_, Model>,
        options: &str,
        remote: Vec<Py<PyAny>>,
    ) -> PyResult<Self> {
        let options = serde_json::from_str(options).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let files = remote::open_all(py, &remote)?;
        Self::new(py, model.clone(), &options, remote, move |detector| match files {
            Some(files) => TiledRun::open_copc(detector, files, &folder),
            None => TiledRun::open(detector, &folder),
        })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, tiles) = (slf.py(), slf.get());
        let options =
            serde_json::to_string(tiles.run.options()).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let remote: Vec<_> = tiles.remote.iter().map(|file| file.clone_ref(py)).collect();
        let arguments = (tiles.folder(), &tiles.model, options, remote).into_pyobject(py)?;
        Ok((slf.get_type().getattr("_open")?, arguments))
    }

    fn __len__(&self) -> usize {
        self.run.tiles().len()
    }

    fn __repr__(&self) -> String {
        format!("Tiles({} tiles in {})", self.run.tiles().len(), self.run.folder().display())
    }
}

/// The results of the tiles of a cloud, made by `Tiles.detected`.
#[pyclass(frozen, module = "snake_rs")]
pub struct DetectedTiles {
    run: Arc<TiledRun>,
    detected: Detected,
}

#[pymethods]
impl DetectedTiles {
    /// The numbers of the tiles without a result. Keypoints there are missing, and those close by may differ.
    #[getter]
    fn missing(&self) -> Vec<usize> {
        let number = |tile: &Tile| self.run.tiles().binary_search_by_key(&tile.place, |tile| tile.place).ok();
        self.detected.missing.iter().filter_map(number).collect()
    }

    /// The number of queries after each step, as of `Keypoints.counts`.
    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        counts_dict(py, &self.detected.counts)
    }

    /// The keypoints of one tile, a dict of arrays (K,): `x`, `y`, `z`, `saliency`, `occupancy`, `nearest_index` (over all
    /// files, in their order), `confidence`, `rank`, `start`, the saliency where it started, and the voxel there, `cell_z`, `cell_y` and `cell_x`.
    ///
    /// The keypoints of all tiles, sorted by falling `rank`, then falling `start`, `cell_z`, `cell_y` and `cell_x`, are those of
    /// `Tiles.finish`, which also limits their number. Raises as `Tiles.detect`.
    fn keypoints<'py>(&self, py: Python<'py>, tile: usize) -> PyResult<Bound<'py, PyDict>> {
        let tile = nth(&self.run, tile)?;
        let keypoints = threads::run_with_signals(py, |control| Ok(self.run.keypoints(tile, &self.detected, control)))?;
        let keypoints = keypoints.map_err(tiles_error)?;
        let positions: Vec<[f64; 3]> =
            keypoints.iter().map(|tiled| add_origin(tiled.keypoint.position, self.run.origin())).collect();
        let columns = PyDict::new(py);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            columns.set_item(name, arrays::values(py, positions.iter().map(|position| position[axis]).collect()))?;
        }
        let scores = |of: fn(&TiledKeypoint) -> f32| arrays::values(py, keypoints.iter().map(of).collect());
        columns.set_item("saliency", scores(|tiled| tiled.keypoint.saliency))?;
        columns.set_item("occupancy", scores(|tiled| tiled.keypoint.occupancy))?;
        let nearest = keypoints.iter().map(|tiled| tiled.keypoint.nearest_index as i64).collect();
        columns.set_item("nearest_index", arrays::values(py, nearest))?;
        let confidence = keypoints.iter().map(|tiled| tiled.keypoint.confidence.unwrap_or(f32::NAN)).collect();
        columns.set_item("confidence", arrays::values(py, confidence))?;
        columns.set_item("rank", arrays::values(py, keypoints.iter().map(|tiled| tiled.rank).collect()))?;
        columns.set_item("start", arrays::values(py, keypoints.iter().map(|tiled| tiled.start).collect()))?;
        for (axis, name) in [(2, "cell_z"), (1, "cell_y"), (0, "cell_x")] {
            columns.set_item(name, arrays::values(py, keypoints.iter().map(|tiled| tiled.cell[axis]).collect()))?;
        }
        Ok(columns)
    }
}
