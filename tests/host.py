"""What tests of all folders use of the host and the application: a module that moves changes one line.

A test of one folder imports the modules of that folder; all else that is not public comes from here.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from benchmarks.peer import disagreement
    from benchmarks.priors_depth import point_errors, reconstructed
    from benchmarks.priors_stereo import NAMES as PAIR_NAMES, load_pair, score as stereo_score
    from core_rasterizer.layout import PARAMETERS, row_count
    from registry.calls.policy import checked_plugins
    from registry.contract.checks.answers import check_sample
    from registry.contract.hook_points import (
        HOOK_POINTS,
        OTHER_HOOKS,
        PIPELINE_POINTS,
        STAGES,
        HookPoint,
    )
    from registry.discovery import (
        GROUP,
        SELECTION,
        Offer,
        Plugins,
        installed_entries,
        offered_name,
    )
    from registry.errors import PipelineError
    from registry.messages.visible_text import is_plain_name, without_credentials
    from registry.pipeline.faults import faults, needs, refuse_unmet_needs
    from registry.pipeline.parts import TRAINING_SECTIONS, Part, Parts, load_scene
    from registry.pipeline.pipeline import (
        Item,
        Pipeline,
        default_schedule,
        load_pipeline,
        parse_pipeline,
    )
    from registry.pipeline.protocols import AppliedProtocol, load_protocol, protocol_names
    from registry.pipeline.schedule import HostSettings
    from registry.pipeline.settings_check import escape_variables, plain, validate_settings
    from registry.pipeline.training_settings import LearningRates, TrainingSettings
    from registry.pipeline.yaml_source import Place, parse as parse_yaml, to_yaml
    from registry.priors.prior_cache import load_estimate, save_estimate
    from registry.recognition import recognize
    from registry.runs.evaluation import evaluate
    from registry.runs.folder import RunFolder
    from registry.runs.opening import load_run
    from registry.runs.preparation import Prepared
    from registry.runs.progress import MetricsLog, TrainingProgress
    from registry.runs.results import Failure, Results, SceneRecord
    from registry.runs.training_run import start_run
    from registry.system.files import jsonable, write_json
    from registry.system.lock import locked
    from registry.system.memory import peak_memory_mb, resident_bytes
    from registry.testing.bench import Bench
    from registry.testing.scenes import pipeline_item, pipeline_of
    from registry.toolkit.cache.entries import FOLDER_VARIABLE
    from registry.toolkit.cache.keys import module_digest
    from registry.toolkit.drawing.pictures import save_view_pictures
    from registry.toolkit.networks.model_file import check_content
    from registry.toolkit.progress.stages import Stages
    from registry.training.assembly import assemble
    from registry.training.checkpoint import (
        CHECKPOINT,
        Checkpoint,
        load_checkpoint,
        read_checkpoint,
        save_checkpoint,
        write_checkpoint,
    )
    from registry.training.field import OPACITY_MARGIN, Field
    from registry.training.initial_model import initial_gaussians, new_model
    from registry.training.trainer import Trainer, ViewOrder
    from stereogs.cli import main, parse as parse_command
    from stereogs.command_line.installed import verbs
    from stereogs.command_line.output import FAILED, conclude
    from stereogs.experiments.comparing.comparability import comparable_groups
    from stereogs.experiments.comparing.comparison import read_run
    from stereogs.experiments.comparing.labels import labels
    from stereogs.experiments.comparing.paper_tables import Numbers, paper_tables
    from stereogs.protocol_scene import pipeline_of as protocol_pipeline
    from stereogs.quality.fitting import Fit
    from stereogs.verbs.completion import Completion
    from stereogs.verbs.models.networks import NETWORKS as KNOWN_NETWORKS
    from stereogs.verbs.new_plugin.package_files import KINDS
    from stereogs.verbs.other_processes import refuse_different_answers
    from stereogs.verbs.replay import repeat_failure
    from stereogs_plugins.metrics.lpips.known_files import KNOWN as LPIPS_FILES
    from stereogs_plugins.reports.html.confidence import confidence as confidence_section
    from stereogs_plugins.reports.html.report import HtmlReport
    from stereogs_plugins.reports.html.run_files import suggested_cameras
    from stereogs_plugins.scenes.dtu.loader import TEST_VIEWS, TRAIN_VIEWS
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
