"""The kinds of mesh files, one reader each: the bytes of a file -> its vertices and triangles."""
