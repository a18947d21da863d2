//! Reads Python pickles as plain data. No code is imported, called or otherwise executed.
//!
//! The opcodes of protocols 0 to 5 build numbers, bytes, lists, dictionaries and objects. An object is the name of its
//! class, its arguments and its state. Only the classes of body models are allowed.
//!
//! The pickle crates for Serde keep the state of an object but not its arguments. The item type of a NumPy array is
//! among the arguments of `numpy.dtype`, so they cannot read the arrays.

mod machine;
mod scanner;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

/// Index of a value. Values may be shared and may even contain themselves, so a traversal must bound its depth.
pub type Id = usize;

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub enum Node<'a> {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// Bytes, or a string as UTF-8.
    Bytes(Cow<'a, [u8]>),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// `module.name` of a class or function.
    Global(String),
    /// An object: the class or function that makes it, a [`Node::Global`], its arguments, a [`Node::Tuple`], and the
    /// state that is set afterwards.
    Object {
        class: Id,
        arguments: Id,
        state: Option<Id>,
    },
}

/// A whole pickle.
#[derive(Debug)]
pub struct Pickle<'a> {
    nodes: Vec<Node<'a>>,
    root: Id,
}

impl<'a> Pickle<'a> {
    /// Reads a pickle. Bytes after its end are ignored.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let (nodes, root) = machine::run(bytes)?;
        Ok(Self { nodes, root })
    }

    /// The value that the pickle holds.
    pub fn root(&self) -> &Node<'a> {
        &self.nodes[self.root]
    }

    /// The value with this index.
    pub fn node(&self, id: Id) -> &Node<'a> {
        &self.nodes[id]
    }

    /// The name of a class or function; empty for any other value.
    pub fn name(&self, id: Id) -> &str {
        match &self.nodes[id] {
            Node::Global(name) => name,
            _ => "",
        }
    }

    /// The items of a tuple or list; none for any other value.
    pub fn items<'b>(&'b self, node: &'b Node) -> impl ExactSizeIterator<Item = &'b Node<'a>> {
        let ids: &[Id] = match node {
            Node::Tuple(ids) | Node::List(ids) => ids,
            _ => &[],
        };
        ids.iter().map(|&id| self.node(id))
    }

    /// The value of a string key in a dictionary.
    pub fn get(&self, dict: &Node, key: &str) -> Option<&Node<'a>> {
        let Node::Dict(items) = dict else { return None };
        let is_key = |id: Id| matches!(self.node(id), Node::Bytes(bytes) if **bytes == *key.as_bytes());
        // As in Python, the last value of a key is valid.
        items.iter().rev().find(|(id, _)| is_key(*id)).map(|(_, value)| self.node(*value))
    }
}
