# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
# ---

# %% [markdown]
# # Does a prefetch unit help a node cache?
# Two built-in scenes, both trees, and caches of 4 to 64 KB. `jupytext --to ipynb notebook.py` makes a notebook of this file.

# %%
import nptrace as nt

runs = nt.render("court", "nave", pixels="32x32", out="traces-notebook")
runs

# %% [markdown]
# ## Misses
# The paper counts prefetches as accesses, so its miss rate falls where demand misses hardly do; the verdict tells them apart.

# %%
replayed = nt.replay(runs, size="4K..64K", ways="1,2", prefetch="none,traced")
print(replayed.notes[-1])
replayed

# %%
rows = replayed.to_arrow().select(["run", "tree", "size_bytes", "ways", "prefetch", "demand_miss_rate", "traffic_ratio"])
rows.sort_by([("demand_miss_rate", "ascending")]).slice(0, 5).to_pylist()

# %% [markdown]
# ## Time
# Misses are not time: late prefetches and busy ports count in cycles.

# %%
timed = nt.time(runs, size="8K", ways=2, rays="1,16", prefetch="stack,push")
print(*timed.notes[-2:], sep="\n")
max(timed, key=lambda row: row["speed_up"])["prefetch"]

# %%
nt.compare(runs[1], prefetch="stack,push", baselines=False)
