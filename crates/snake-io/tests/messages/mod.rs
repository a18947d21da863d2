//! Messages of ROS for made recordings.

/// The schema of clouds.
pub const SCHEMA: &str = "sensor_msgs/msg/PointCloud2";

/// A message with the ring and the coordinates of each point.
pub fn encoded_points(is_ros2: bool, points: &[[f32; 4]]) -> Vec<u8> {
    let num_points = points.len() as u32;
    let mut data = Vec::new();
    let number = |data: &mut Vec<u8>, value: u32| {
        if is_ros2 {
            data.resize(data.len().next_multiple_of(4), 0);
        }
        data.extend(value.to_le_bytes());
    };
    let text = |data: &mut Vec<u8>, text: &str| {
        number(data, text.len() as u32 + u32::from(is_ros2));
        data.extend(text.bytes().chain(is_ros2.then_some(0)));
    };
    if !is_ros2 {
        number(&mut data, 77);
    }
    number(&mut data, 1);
    number(&mut data, 500);
    text(&mut data, "lidar");
    number(&mut data, 1);
    number(&mut data, num_points);
    number(&mut data, 4);
    for (name, offset, datatype) in [("ring", 0, 4), ("x", 4, 7), ("y", 8, 7), ("z", 12, 7)] {
        text(&mut data, name);
        number(&mut data, offset);
        data.push(datatype);
        number(&mut data, 1);
    }
    data.push(0);
    number(&mut data, 16);
    number(&mut data, 16 * num_points);
    number(&mut data, 16 * num_points);
    data.extend(points.as_flattened().iter().flat_map(|value| value.to_le_bytes()));
    data.push(1);
    data
}
