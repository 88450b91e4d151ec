"""Models that others wrote, rewritten: the layers, and how forward calls them, are theirs.

Each says its repository and path. Sizes are smaller where the original's are arguments or
constants; what only plots or records is left out.
"""

import torch
from torch import nn


def tutorial_5(num_inputs=784, num_hidden=1000, num_outputs=10, num_steps=25, beta=0.95):
    """jeshraghian/snntorch, docs/tutorials/tutorial_5.rst: an image in all timesteps."""
    import snntorch as snn

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.fc1 = nn.Linear(num_inputs, num_hidden)
            self.lif1 = snn.Leaky(beta=beta)
            self.fc2 = nn.Linear(num_hidden, num_outputs)
            self.lif2 = snn.Leaky(beta=beta)

        def forward(self, x):
            mem1 = self.lif1.init_leaky()
            mem2 = self.lif2.init_leaky()
            spk2_rec, mem2_rec = [], []
            for _ in range(num_steps):
                cur1 = self.fc1(x)
                spk1, mem1 = self.lif1(cur1, mem1)
                cur2 = self.fc2(spk1)
                spk2, mem2 = self.lif2(cur2, mem2)
                spk2_rec.append(spk2)
                mem2_rec.append(mem2)
            return torch.stack(spk2_rec, dim=0), torch.stack(mem2_rec, dim=0)

    return Net()


def tutorial_regression_2(num_inputs=784, hidden=128, timesteps=10, beta=0.9):
    """jeshraghian/snntorch, docs/tutorials/tutorial_regression_2.rst: recurrent layers."""
    import snntorch as snn

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.fc1 = nn.Linear(in_features=num_inputs, out_features=hidden)
            self.rlif1 = snn.RLeaky(beta=beta, linear_features=hidden)
            self.fc2 = nn.Linear(in_features=hidden, out_features=10)
            self.rlif2 = snn.RLeaky(beta=beta, linear_features=10)

        def forward(self, x):
            spk1, mem1 = self.rlif1.init_rleaky()
            spk2, mem2 = self.rlif2.init_rleaky()
            spk_recording = []
            for _ in range(timesteps):
                spk1, mem1 = self.rlif1(self.fc1(x), spk1, mem1)
                spk2, mem2 = self.rlif2(self.fc2(spk1), spk2, mem2)
                spk_recording.append(spk2)
            return torch.stack(spk_recording)

    return Net()


def primate_reaching(input_size=96, hidden_size=50, tau=0.96, p=0.3):
    """NeuroBench/neurobench, examples/primate_reaching/SNN2.py: membranes are the output."""
    import snntorch as snn
    from snntorch import surrogate

    class SNN2(nn.Module):
        def __init__(self):
            super().__init__()
            spike_grad = surrogate.fast_sigmoid(slope=20)
            same = {"spike_grad": spike_grad, "threshold": 1, "learn_beta": False}
            self.fc1 = nn.Linear(input_size, hidden_size, bias=False)
            self.fc_out = nn.Linear(hidden_size, 2, bias=False)
            self.lif1 = snn.Leaky(beta=tau, reset_mechanism="zero", **same)
            self.lif_out = snn.Leaky(beta=tau, reset_mechanism="none", **same)
            self.inputs, self.spikes_1, self.spikes_2 = [], [], []
            self.dropout = nn.Dropout(p)
            self.reset()

        def reset(self):
            self.mem1 = self.lif1.init_leaky()
            self.mem2 = self.lif_out.init_leaky()

        def single_forward(self, x):
            x = x.squeeze()
            cur1 = self.dropout(self.fc1(x))
            spk1, self.mem1 = self.lif1(cur1, self.mem1)
            cur2 = self.fc_out(spk1)
            _, self.mem2 = self.lif_out(cur2, self.mem2)
            self.inputs.append(x)
            self.spikes_1.append(spk1)
            self.spikes_2.append(self.mem2)
            return self.mem2.clone()

        def forward(self, x):
            predictions = []
            for sample in range(x.shape[0]):
                predictions.append(self.single_forward(x[sample, ...]))  # noqa: PERF401
            return torch.stack(predictions)

    return SNN2()


def speech_commands(inputs=20, hidden=256, beta=0.9):
    """NeuroBench/neurobench, examples/gsc/SNN.py: states inside, one timestep a call."""
    import snntorch as snn
    from snntorch import surrogate

    same = {"beta": beta, "spike_grad": surrogate.fast_sigmoid(), "init_hidden": True}
    return nn.Sequential(
        nn.Flatten(),
        nn.Linear(inputs, hidden),
        snn.Leaky(**same),
        nn.Linear(hidden, hidden),
        snn.Leaky(**same),
        nn.Linear(hidden, hidden),
        snn.Leaky(**same),
        nn.Linear(hidden, 35),
        snn.Leaky(**same, output=True),
    )


def prosthesis(input_size=8):
    """VShreya-git/STMInnovationFair2026, EMG-SNN-Prosthetic/SNN_Training/snn_model.py.txt."""
    import snntorch as snn

    class SNN(nn.Module):
        def __init__(self):
            super().__init__()
            self.fc1 = nn.Linear(input_size, 32)
            self.lif1 = snn.Leaky(beta=0.95)
            self.fc2 = nn.Linear(32, 2)
            self.lif2 = snn.Leaky(beta=0.95)

        def forward(self, x):
            mem1, mem2 = self.lif1.init_leaky(), self.lif2.init_leaky()
            spk_rec = []
            for t in range(x.size(0)):
                cur1 = self.fc1(x[t])
                spk1, mem1 = self.lif1(cur1, mem1)
                cur2 = self.fc2(spk1)
                spk2, mem2 = self.lif2(cur2, mem2)
                spk_rec.append(spk2)
            return torch.stack(spk_rec)

    return SNN()


def poker_dvs(shape=(2, 35, 35), hidden_features=100, output_features=4):
    """norse/notebooks, poker-dvs_classifier: a recurrent layer, and a readout that integrates."""
    from norse.torch import LICell, LIFParameters
    from norse.torch.module.lif import LIFRecurrentCell

    features = int(torch.tensor(shape).prod())

    class SNN(nn.Module):
        def __init__(self):
            super().__init__()
            self.l1 = LIFRecurrentCell(
                features,
                hidden_features,
                p=LIFParameters(
                    alpha=100,
                    v_th=torch.as_tensor(0.3),
                    tau_syn_inv=torch.tensor(1 / 1e-2),
                    tau_mem_inv=torch.tensor(1 / 1e-2),
                ),
                dt=1e-3,
            )
            self.fc_out = nn.Linear(hidden_features, output_features, bias=False)
            self.out = LICell(dt=1e-3)

        def forward(self, x):
            seq_length, _batch_size, _, _, _ = x.shape
            s1 = so = None
            voltages = []
            for ts in range(seq_length):
                z = x[ts, :, :, :].view(-1, features)
                z, s1 = self.l1(z, s1)
                z = self.fc_out(z)
                vo, so = self.out(z, so)
                voltages += [vo]
            return torch.stack(voltages)

    return SNN()


def eeg_classifier(input_channels=8):
    """skiwan/SnnVsAnn, Models/SNN/BinaryEEGClassifierLIF.py: layers over all timesteps."""
    from norse.torch import LIF, SequentialState

    class BinaryEEGClassifierLIF(nn.Module):
        def __init__(self):
            super().__init__()
            linear_1, linear_2 = nn.Linear(input_channels, 2), nn.Linear(2, 1)
            for linear in (linear_1, linear_2):
                linear.weight = nn.Parameter(torch.abs(linear.weight))
            self.model = SequentialState(linear_1, LIF(), linear_2, LIF())

        def forward(self, x):
            return self.model(x)

    return BinaryEEGClassifierLIF()
