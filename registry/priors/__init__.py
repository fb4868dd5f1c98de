"""Prior models: what each capability is asked, how answers are kept, how model files are run."""
