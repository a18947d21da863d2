//! The topics of a recording.

use snake_geometry::excerpt;

/// The schemas of the messages that are read: of ROS 2, of ROS 1, and of ROS 2 as its middleware names it.
const SCHEMAS: [&str; 3] =
    ["sensor_msgs/msg/PointCloud2", "sensor_msgs/PointCloud2", "sensor_msgs::msg::dds_::PointCloud2_"];

/// The given topic, or the only topic with point clouds. `topics` has the topics and the schemas of their messages.
pub(crate) fn chosen(topics: &[(String, String)], given: Option<&str>) -> Result<String, String> {
    let is_cloud = |schema: &str| SCHEMAS.contains(&schema);
    let clouds: Vec<&str> =
        topics.iter().filter(|(_, schema)| is_cloud(schema)).map(|(topic, _)| topic.as_str()).collect();
    let listed = || match &clouds[..] {
        [] if topics.is_empty() => "the file has no messages".to_owned(),
        [] => without_clouds(topics),
        clouds => format!("topics with point clouds: {}", clouds.join(", ")),
    };
    match (given, &clouds[..]) {
        (Some(given), _) => match topics.iter().find(|(topic, _)| topic == given) {
            Some((_, schema)) if is_cloud(schema) => Ok(given.to_owned()),
            Some((_, schema)) => Err(format!("topic {given} has messages {schema}, not point clouds; {}", listed())),
            None => Err(format!("no messages of the topic {given}; {}", listed())),
        },
        (None, [topic]) => Ok((*topic).to_owned()),
        (None, []) => Err(listed()),
        (None, _) => Err(format!("which topic? {}; give one: `topic` {}", listed(), clouds[0])),
    }
}

/// The error for a recording without point clouds: its topics, and how to convert some of them.
fn without_clouds(topics: &[(String, String)]) -> String {
    let all: Vec<String> = topics.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect();
    let all = excerpt(&all.join(", "), 1000);
    let advice = topics.iter().find_map(|(topic, schema)| Some(format!("; {topic}: {}", conversion(schema)?)));
    format!("no topic has point clouds (sensor_msgs/PointCloud2); topics: {all}{}", advice.unwrap_or_default())
}

/// How to convert messages of a sensor to point clouds.
fn conversion(schema: &str) -> Option<&'static str> {
    let name = schema.rsplit(['/', '.', ':']).next().unwrap_or(schema);
    Some(match name {
        "CustomMsg" => "the driver of Livox writes PointCloud2 with xfer_format: 0 in its launch file; record that",
        "LaserScan" | "MultiEchoLaserScan" => "a scan of one plane has no three-dimensional keypoints",
        "PointCloud" if schema.starts_with("foxglove") => {
            "it is encoded as foxglove.PointCloud; record sensor_msgs/PointCloud2, or unpack it with the Python package mcap \
             and give the arrays to snake_rs.detect"
        }
        "PointCloud" => "the old PointCloud; convert it: ros2 run point_cloud_converter point_cloud_converter_node",
        "DepthImage" | "Image" | "CompressedImage" => {
            "depth images become clouds: ros2 run depth_image_proc point_cloud_xyz_node; record its topic: ros2 bag record /points"
        }
        _ if name.contains("Packet") || name == "VelodyneScan" => {
            "packets of a scanner; play the recording to its driver, and record the clouds: ros2 bag record /TOPIC"
        }
        _ => return None,
    })
}
