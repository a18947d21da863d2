//! The topics of MCAP files.

/// The topics and the schemas of their messages, in the order of the file. A damaged end is left to the reader.
pub(crate) fn topics(bytes: &[u8]) -> std::result::Result<Vec<(String, String)>, String> {
    let mut topics = Vec::new();
    for message in ::mcap::MessageStream::new(bytes).map_err(|error| error.to_string())? {
        let Ok(message) = message else { break };
        let schema = message.channel.schema.as_ref().map_or("without a schema", |schema| &schema.name);
        if topics.iter().all(|(topic, _)| *topic != message.channel.topic) {
            topics.push((message.channel.topic.clone(), schema.to_owned()));
        }
    }
    Ok(topics)
}
