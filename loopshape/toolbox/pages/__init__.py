"""What is written as a page of HTML: a loop shaped by hand (`shape`), all that is known of a run (`report`).

FRFs, controllers, requirements or a run folder come in; files that open offline go out. The pages' scripts are
TypeScript in `script`.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "pages",
    "What is written as a page of HTML: a loop shaped by hand, all that is known of a run",
    commands=(
        Command(
            "Design",
            "shape",
            "loopshape.toolbox.pages.commands:shape",
            "loopshape shape runs/axis --require requirements.toml --out shape.html",
            20,
        ),
        Command(
            "Verify",
            "report",
            "loopshape.toolbox.pages.commands:report",
            "loopshape report runs/axis --controller controller.toml --require requirements.toml",
            40,
        ),
    ),
    verbs={"report": "loopshape.toolbox.pages.verbs", "shape": "loopshape.toolbox.pages.verbs"},
)
