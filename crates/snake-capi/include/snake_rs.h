// C interface of snake-rs. cbindgen writes this file: SNAKE_WRITE_HEADER=1 cargo test --release -p snake-capi --test header

#ifndef SNAKE_RS_H
#define SNAKE_RS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// The result of a function. `snake_last_error` has the reason as text.
typedef enum SnakeStatus {
  /// The result is complete.
  SNAKE_STATUS_OK = 0,
  /// A pointer is null or misaligned, a text is not UTF-8, or a length is impossible.
  SNAKE_STATUS_ARGUMENT = 1,
  /// A cloud that cannot be used, without finite points or without extent; or clouds that no transform fits.
  SNAKE_STATUS_INPUT = 2,
  /// Options that cannot be used: no JSON object, an unknown name, or a value of another type or out of its range.
  SNAKE_STATUS_OPTION = 3,
  /// A weight file does not hold the network that it names.
  SNAKE_STATUS_WEIGHTS = 4,
  /// A file cannot be read.
  SNAKE_STATUS_IO = 5,
  /// An error within the library, which is a defect of it.
  SNAKE_STATUS_INTERNAL = 6,
} SnakeStatus;

/// The keypoints of a cloud.
typedef struct SnakeDetection SnakeDetection;

/// A network with its weights, or the choice between those that are built in. Several threads may use one at the same time.
typedef struct SnakeModel SnakeModel;

/// A cloud of the caller, which is read where it is.
typedef struct SnakeCloud {
  /// x, y and z of the first point.
  const float *points;
  /// Number of points.
  size_t num_points;
  /// Number of floats from one point to the next: 3 for packed points, 4 for `pcl::PointXYZ`.
  size_t stride;
} SnakeCloud;

/// A keypoint, in the frame and units of the cloud.
typedef struct SnakeKeypoint {
  /// x, y and z.
  float position[3];
  /// Saliency, 0 to 1. Keypoints are ranked by it, in scenes also by how well the points determine their place.
  float saliency;
  /// Occupancy at the position, 0 to 1.
  float occupancy;
  /// Index of the nearest point of the cloud, of all its points.
  size_t nearest_index;
  /// Probability that another view finds it again, 0 to 1; NaN if the model has no map of confidences.
  float confidence;
  /// Covariance of the position by the points around it, row by row, in squared cloud units; infinite along directions that
  /// they leave open.
  float covariance[9];
} SnakeKeypoint;

/// The rigid transform between two clouds.
typedef struct SnakeRegistration {
  /// The 4x4 matrix, row by row. It maps a point of the source to the target: `p_target = R p_source + t`.
  double t_target_source[16];
  /// How likely the transform is right, 0 to 1.
  double confidence;
  /// Whether the transform can be relied on: `confidence` is at least 0.5.
  bool is_reliable;
  /// Whether the clouds leave more than one answer, as a plane or a periodic structure does; then it is not reliable.
  bool is_ambiguous;
  /// Number of matches.
  size_t num_matches;
  /// Number of matches on which the transform was built.
  size_t num_inliers;
  /// Share of the source on the target, 0 to 1.
  double fitness;
  /// Root mean square distance of that part, in cloud units.
  double fitness_rmse;
} SnakeRegistration;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/// Detects the keypoints of a cloud. Points that are not finite, and a few that are much farther than all others, are left out.
/// A cloud without finite points is an error.
///
/// `options` is null for what the model recommends, or a JSON object of values that replace those, such as
/// `{"max_keypoints": 20, "nms_radius": "3r"}`; `"preset"` names a set of options to begin with. `*detection` is null after an
/// error.
///
/// # Safety
/// `model` is null or a model that is not freed yet; `cloud` has as many points as it says; `options` is null or a text
/// that ends with a zero; `detection` is null or valid for a write.
enum SnakeStatus snake_detect(const struct SnakeModel *model,
                              struct SnakeCloud cloud,
                              const char *options,
                              struct SnakeDetection **detection);

/// The number of keypoints; 0 for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
size_t snake_detection_num_keypoints(const struct SnakeDetection *detection);

/// The keypoints, best first, valid until the detection is freed; null for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
const struct SnakeKeypoint *snake_detection_keypoints(const struct SnakeDetection *detection);

/// The name of the model that found the keypoints, such as "scenes, built-in", valid until the detection is freed; null for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
const char *snake_detection_model(const struct SnakeDetection *detection);

/// The size of a voxel of the model's volume, in cloud units; NaN for null.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
float snake_detection_voxel_size(const struct SnakeDetection *detection);

/// A sentence that a user should know: of the choice of the model, the cloud's scale, outliers, or keypoints that cluster. `index`
/// counts from 0; null after the last one. It is UTF-8 and valid until the detection is freed.
///
/// # Safety
/// `detection` is null or a detection that is not freed yet.
const char *snake_detection_note(const struct SnakeDetection *detection,
                                 size_t index);

/// Frees a detection; null is allowed.
///
/// # Safety
/// `detection` is null or a detection of this library that is not freed yet.
void snake_detection_free(struct SnakeDetection *detection);

/// The built-in model that suits each cloud, chosen anew by every call, as `snake-cli` does without `--model`. Options that only
/// one kind of model has name it: `voxel_size` "scenes", and `preset`, `normalization` and several `rotations` "compact". Else it
/// is "scenes" for a cloud that looks like a room, a sweep or terrain, and "compact" for others. Each is loaded when it is
/// first used. `*model` is null after an error.
///
/// # Safety
/// `model` is null or valid for a write.
enum SnakeStatus snake_model_auto(struct SnakeModel **model);

/// A built-in model: "compact" or "standard" for objects, "scenes" for rooms, sweeps and terrain. `*model` is null after an error.
///
/// # Safety
/// `name` is null or a text that ends with a zero; `model` is null or valid for a write.
enum SnakeStatus snake_model_named(const char *name,
                                   struct SnakeModel **model);

/// Reads a weight file (safetensors). `*model` is null after an error.
///
/// # Safety
/// `path` is null or a text in UTF-8 that ends with a zero; `model` is null or valid for a write.
enum SnakeStatus snake_model_load(const char *path, struct SnakeModel **model);

/// A model from the bytes of a weight file. `*model` is null after an error.
///
/// # Safety
/// `bytes` is null or valid for `length` bytes; `model` is null or valid for a write.
enum SnakeStatus snake_model_from_bytes(const uint8_t *bytes, size_t length, struct SnakeModel **model);

/// Frees a model; null is allowed.
///
/// # Safety
/// `model` is null or a model of this library that is not freed yet.
void snake_model_free(struct SnakeModel *model);

/// The version of the library, such as "0.1.0".
const char *snake_version(void);

/// Finds the rigid transform from `source` to `target`, clouds of the same unit that may overlap in part, without an
/// initial guess. `model` runs only if the options ask for its keypoints or descriptors; else it may be null. Points are left out as in
/// `snake_detect`, and those that stand for missing returns, such as many at (0, 0, 0).
///
/// `options` is null for the defaults, or a JSON object such as `{"gravity": "z", "hypotheses": 5}`. After an error
/// `*registration` is unchanged.
///
/// # Safety
/// `model` is null or a model that is not freed yet; the clouds have as many points as they say; `options` is null or a
/// text that ends with a zero; `registration` is null or valid for a write.
enum SnakeStatus snake_register(const struct SnakeModel *model,
                                struct SnakeCloud source,
                                struct SnakeCloud target,
                                const char *options,
                                struct SnakeRegistration *registration);

/// The reason of the last error of this thread, or an empty text. It is UTF-8 and valid until the next function of this
/// library that this thread calls.
const char *snake_last_error(void);

/// Sets the number of threads of all calls, from the next one on; 0: one for each core. At most 256, or the number of cores.
/// The environment variable `RAYON_NUM_THREADS` does the same. A child after a fork keeps the number and has threads of its own.
enum SnakeStatus snake_set_num_threads(size_t num_threads);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SNAKE_RS_H */
