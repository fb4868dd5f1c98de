"""Which depths the views of a scene confirm, and whose depth counts where several priors answer."""
