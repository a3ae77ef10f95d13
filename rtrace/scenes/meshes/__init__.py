"""One reader for each mesh format: the bytes of a file -> its vertices and triangles."""
