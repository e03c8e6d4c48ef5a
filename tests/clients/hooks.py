"""What schemathesis cannot know from the document."""

import os

import schemathesis


@schemathesis.deserializer("image/png", "image/x-portable-graymap")
def picture(ctx, response):
    """A picture is its bytes."""
    return response.content.decode("latin-1")


def is_positive(case):
    return case.meta is not None and case.meta.generation.mode.is_positive


@schemathesis.hook
def filter_case(ctx, case):
    """Cursors are those that the service gave: made-up ones are left to requests that are to be refused. The field
    `key` of a key, which is null in lists, is no id of one."""
    in_path = (case.path_parameters or {}).values()
    return not is_positive(case) or ("cursor" not in (case.query or {}) and "null" not in map(str, in_path))


@schemathesis.hook
def map_case(ctx, case):
    """Good requests are about a route that is there."""
    if is_positive(case) and "route" in (case.path_parameters or {}):
        case.path_parameters["route"] = os.environ["ROUTE"]
    return case
