"""Mutations of the targets of output: outputs, run names, cache folders, interrupts."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

OUT, NAMES, KEPT = "tests/nptrace/test_outputs.py", "tests/nptrace/test_run_names.py", "tests/nptrace_base/test_kernel_cache.py"

MUTATIONS = [
    Mutation("outputs: a FIFO is replaced by a file", "nptrace_base/atomic.py",
             "return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)", "return False", f"{OUT}::test_a_fifo_is_written_into"),
    Mutation("outputs: a link is replaced by a file", "nptrace_base/atomic.py",
             "real = Path(os.path.realpath(path))", "real = path", f"{OUT}::test_a_link_is_followed_to_a_file_that_keeps_its_permissions"),
    Mutation("outputs: permissions of the file before are lost", "nptrace_base/atomic.py",
             "temporary.chmod(stat.S_IMODE(path.stat().st_mode))", "path.stat()", f"{OUT}::test_a_link_is_followed_to_a_file_that_keeps_its_permissions"),
    Mutation("outputs: a read-only file is replaced", "nptrace_base/atomic.py",
             "not (mode is None or _may_write(real)) or ", "", f"{OUT}::test_a_read_only_file_is_not_replaced"),
    Mutation("outputs: a missing folder is known only when all is done", "nptrace/output.py",
             "                check_writable(path)\n", "                pass\n", f"{OUT}::test_an_output_that_cannot_be_written_is_known_before_any_work"),
    Mutation("outputs: a run that is a link is replaced by a folder", "traces/writer.py",
             "self._real = Path(os.path.realpath(path))", "self._real = Path(path)", f"{OUT}::test_a_run_that_is_a_link_is_written_where_it_leads"),
    Mutation("outputs: a link that was left is not swept", "traces/writer.py",
             "        path.unlink(missing_ok=True)\n", "        pass\n", f"{OUT}::test_links_that_were_left_are_swept_and_what_they_lead_to_stays"),
    Mutation("outputs: a run under a name that is not UTF-8 fails", "traces/writer.py",
             'pa.OSFile(os.fsencode(path), "wb")', 'pa.OSFile(str(path), "wb")', f"{OUT}::test_names_that_are_not_utf8_are_written"),
    Mutation("names: two scenes of one name are one run", "rtrace/render.py",
             "paths.count(path) > 1", "paths.count(path) > 9", f"{NAMES}::test_two_scenes_of_one_name_are_refused_before_anything_is_traced"),
    Mutation("names: another run is replaced unasked", "traces/writer.py",
             "    if unlike:\n", "    if not unlike:\n", f"{NAMES}::test_another_run_of_the_name_is_kept_unless_it_may_be_replaced"),
    Mutation("names: another mesh with the same picture is the same run", "traces/footer.py",
             "footer.scene.sha256, footer.scene.stand_in", "footer.scene.stand_in, footer.scene.stand_in", NAMES),
    Mutation("names: runs with an underscore are not found", "traces/reader.py",
             'not p.name.startswith(".")', 'not p.name.startswith((".", "_"))', f"{NAMES}::test_every_run_is_found_but_hidden_ones"),
    Mutation("kept: the group may write to a folder of kernels", "nptrace_base/folders.py",
             "found.st_mode & 0o022", "found.st_mode & 0o002", f"{KEPT}::test_only_a_folder_of_ours_that_nobody_else_may_write_to_is_private"),
    Mutation("kept: a link to a folder is a folder", "nptrace_base/folders.py",
             "found = folder.lstat()", "found = folder.stat()", f"{KEPT}::test_only_a_folder_of_ours_that_nobody_else_may_write_to_is_private"),
    Mutation("kept: another user's folder is ours", "nptrace_base/folders.py",
             "found.st_uid != os.geteuid()", "found.st_uid < 0", f"{KEPT}::test_only_a_folder_of_ours_that_nobody_else_may_write_to_is_private"),
    Mutation("kept: folders are made for all", "nptrace_base/folders.py",
             "part.mkdir(mode=0o700)", "part.mkdir()", f"{KEPT}::test_only_a_folder_of_ours_that_nobody_else_may_write_to_is_private"),
    Mutation("kept: a full folder stops a replay", "nptrace_base/jit.py",
             'compiling.not_kept("kernels", {Path(self._cache_path).parent: e})', "raise", f"{KEPT}::test_a_full_folder_stops_nothing"),
    Mutation("kept: a module imported from a package does not count", "nptrace_base/sources.py",
             '            yield from (f"{base}.{alias.name}" for alias in node.names)\n', "", f"{KEPT}::test_what_a_file_imports_is_found_as_python_finds_it"),
    Mutation("kept: only what a file imports itself counts", "nptrace_base/sources.py",
             "            todo += _imported(path)\n", "            found.update(_imported(path))\n", f"{KEPT}::test_trees_and_kernels_change_with_what_they_stand_on_and_with_nothing_else"),
    Mutation("messages: a bug passes for a bad input", "nptrace/groups.py",
             "        except NptraceError as e:\n            raise BadInput(str(e)) from e\n        except MemoryError", "        except ValueError as e:\n            raise BadInput(str(e)) from e\n        except MemoryError", "tests/nptrace/test_messages.py::test_a_bug_is_no_message"),
    Mutation("interrupts: Ctrl-C is an abort with a word", "nptrace/groups.py",
             "raise SystemExit(INTERRUPTED)", "raise KeyboardInterrupt", "tests/nptrace/test_interrupts.py::test_compiling_ends_quietly_with_its_processes"),
    Mutation("interrupts: threads are waited for", "nptrace_base/pools.py",
             "wait=isinstance(e, Exception)", "wait=True", "tests/nptrace/test_interrupts.py::test_who_is_interrupted_does_not_wait_for_threads"),
    Mutation("progress: --quiet says as much as ever", "nptrace/progress.py", "if level < USUAL:", "if False:", "tests/nptrace/test_nptrace.py -k says_what"),
    Mutation("progress: what carries no news is always said", "nptrace/progress.py", "if level >= VERBOSE:", "if True:", "tests/nptrace/test_nptrace.py -k says_what"),
    Mutation("progress: no phase is told", "nptrace/progress.py", '(f": {what}" if what else "")', '""', "tests/nptrace/test_terminal.py -k real"),
]
