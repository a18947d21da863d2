// Keypoints of a cloud, and the transform between two clouds, from C++.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "snake_rs.h"

struct Point {
    float x, y, z, padding;  // as pcl::PointXYZ
};

static SnakeCloud view(const std::vector<Point> &points) {
    return {&points.data()->x, points.size(), sizeof(Point) / sizeof(float)};
}

static void check(SnakeStatus status) {
    if (status != SNAKE_STATUS_OK) {
        std::fprintf(stderr, "error %d: %s\n", status, snake_last_error());
        std::exit(1);
    }
}

int main() {
    // A torus with a dent, and the same after a quarter turn about z and a shift of 3 along x.
    std::vector<Point> source, target;
    for (int i = 0; i < 4000; ++i) {
        const float u = 0.1f * i, v = 0.7f * i, ring = 1 + 0.3f * std::cos(v);
        const float x = ring * std::cos(u), y = ring * std::sin(u);
        const float z = 0.3f * std::sin(v) + std::fmax(x - 0.4f * y, 0.5f);
        source.push_back({x, y, z, 1});
        target.push_back({3 - y, x, z, 1});
    }

    SnakeModel *loaded = nullptr;
    check(snake_model_named("compact", &loaded));
    const std::unique_ptr<SnakeModel, decltype(&snake_model_free)> model(loaded, snake_model_free);

    // Values of options replace those that the model recommends.
    SnakeDetection *found = nullptr;
    check(snake_detect(model.get(), view(source), R"({"max_keypoints": 5})", &found));
    const std::unique_ptr<SnakeDetection, decltype(&snake_detection_free)> detection(found, snake_detection_free);
    const SnakeKeypoint *keypoints = snake_detection_keypoints(detection.get());
    for (size_t i = 0; i < snake_detection_num_keypoints(detection.get()); ++i) {
        const float *p = keypoints[i].position;
        std::printf("keypoint %.3f %.3f %.3f saliency %.3f\n", p[0], p[1], p[2], keypoints[i].saliency);
    }

    SnakeRegistration registration;
    // Only keypoints and descriptors of the field need a model here.
    check(snake_register(nullptr, view(source), view(target), nullptr, &registration));
    const double *t = registration.t_target_source;
    std::printf("translation %.2f %.2f %.2f, %s\n", t[3], t[7], t[11], registration.is_reliable ? "reliable" : "not reliable");

    // An error is a code and a text.
    const SnakeStatus status = snake_detect(model.get(), {nullptr, 10, 3}, nullptr, &found);
    std::printf("without points: error %d, %s\n", status, snake_last_error());
    return 0;
}
