"""Trees: builders, node layouts, the cache of built trees."""
